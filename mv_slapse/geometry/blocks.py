"""Sizes of the blocks that a codec's pictures are cut into."""

MACROBLOCK = 16  # px, of MPEG-1/2/4, H.263 and H.264: vectors of one and of its neighbours agree
CELL = 8  # px, the smallest partition that decoders report

"""Procedural textures; only their names so far."""

NAMES = ('asphalt', 'paving', 'paint', 'patch', 'brick', 'plaster', 'windows', 'shops', 'panels',
         'car_end', 'car_side', 'car_top', 'tower', 'sky')
TILE_SIZE = {  # side of one tile [m]; 1: the tile covers the quad
    'asphalt': 10.0, 'paving': 8.0, 'paint': 4.0, 'patch': 3.0, 'brick': 8.0, 'plaster': 9.0,
    'windows': 14.0, 'shops': 16.0, 'panels': 12.0, 'tower': 20.0, 'sky': 15000.0}
FACADES = ('brick', 'plaster', 'windows', 'shops', 'panels')


def index(name: str) -> int:
    """Return the number of a texture."""
    return NAMES.index(name)

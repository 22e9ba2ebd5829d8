from mv_slapse.codec.motion_vectors import columns
import numpy as np

EXPORTED = np.dtype([
    ('source', '<i4'), ('w', 'u1'), ('h', 'u1'), ('src_x', '<i2'), ('src_y', '<i2'),
    ('dst_x', '<i2'), ('dst_y', '<i2'), ('flags', '<u8'), ('motion_x', '<i4'),
    ('motion_y', '<i4'), ('motion_scale', '<u2')], align=True)


def rows(*values):
    table = np.zeros(len(values), EXPORTED)
    for row, value in zip(table, values, strict=True):
        for name, item in value.items():
            row[name] = item
    return table.view(np.uint8)


def test_first_macroblock_is_centred_at_seven_and_a_half():
    table = columns(rows({'w': 16, 'h': 16, 'dst_x': 8, 'dst_y': 8, 'motion_scale': 4}))
    np.testing.assert_array_equal(table['x'], [[7.5, 7.5]])
    np.testing.assert_array_equal(table['block'], [[16, 16]])


def test_displacement_is_exact_where_ffmpeg_rounds_the_source():
    table = columns(rows({'dst_x': 24, 'dst_y': 8, 'src_x': 25, 'src_y': 7, 'motion_x': 5,
                          'motion_y': -3, 'motion_scale': 4}))
    np.testing.assert_array_equal(table['displacement'], [[1.25, -0.75]])


def test_direction_is_the_sign_of_the_source():
    table = columns(rows({'source': -1}, {'source': 1}, {'source': -2}))
    np.testing.assert_array_equal(table['direction'], [-1, 1, -1])


def test_a_picture_without_vectors_has_no_columns():
    assert columns(None) == {}
    assert columns(np.zeros(0, np.uint8)) == {}

from mv_slapse import fields
from mv_slapse.codec.packet import Packet
from mv_slapse.errors import UnusableInput, UsageError
from mv_slapse.geometry.camera import Camera
from mv_slapse.records import Speed
from mv_slapse.storage.bag_reader import BagReader, is_bag
from mv_slapse.storage.bag_writer import BagWriter, McapFile
from mv_slapse.storage.messages import typestore
from mv_slapse.tools.inputs import open_input
from mv_slapse.video_messages import FFMPEG_PACKET, IMAGE, packet_to_fields
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

CAMERA = Camera(64, 48, np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]]))
STAMPS = [0, 300, 100, 200, 600, 400, 500]  # decoding order of I P B B P B B


def packet(k, stamp):
    return Packet(bytes([0, 0, 1, 0, 0, 8 * (1 if k == 0 else 2), k]) * 40, stamp, k == 0,
                  'mpeg2video')


def fill(bag, topics=('/camera/image/ffmpeg',)):
    for topic in topics:
        for k, stamp in enumerate(STAMPS):
            bag.write(topic, FFMPEG_PACKET,
                      packet_to_fields(packet(k, stamp), (64, 48), k, 'eye'), stamp)


@pytest.fixture
def bag(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        writer.write('/camera/camera_info', 'sensor_msgs/msg/CameraInfo',
                     fields.camera_to_fields(CAMERA, 0, 'eye'), 0, latched=True)
        fill(writer)
    return tmp_path / 'bag'


@pytest.fixture(params=['folder', 'file'])
def path(request, bag):
    return bag if request.param == 'folder' else bag / 'bag.mcap'


def test_packets_come_back_in_the_order_of_decoding(path):
    assert is_bag(path)
    reader = BagReader(path)
    assert reader.video_topic() == '/camera/image/ffmpeg'
    assert list(reader.packets('/camera/image/ffmpeg')) == [packet(k, stamp)
                                                            for k, stamp in enumerate(STAMPS)]


def test_the_calibration_comes_with_the_video(path):
    camera = BagReader(path).camera('/camera/image/ffmpeg')
    assert (camera.width, camera.height) == (64, 48)
    np.testing.assert_array_equal(camera.K, CAMERA.K)


def odometry(stamp, forward, left=0.0):
    """Return the fields of a nav_msgs/Odometry of wheels."""
    zero = {'x': 0.0, 'y': 0.0, 'z': 0.0}
    pose = {'position': zero, 'orientation': {**zero, 'w': 1.0}}
    return {'header': fields.header(stamp, 'odom'), 'child_frame_id': 'base_link',
            'pose': {'pose': pose, 'covariance': np.zeros(36)},
            'twist': {'twist': {'linear': {**zero, 'x': forward, 'y': left}, 'angular': zero},
                      'covariance': np.zeros(36)}}


def test_speeds_are_those_of_a_topic_with_odometry(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        fill(writer)
        for i, (forward, left) in enumerate(((3.0, 4.0), (-2.0, 0.0))):
            writer.write('/wheels/odom', 'nav_msgs/msg/Odometry',
                         odometry(10**18 + 100 * i, forward, left), 100 * i)
    reader = BagReader(tmp_path / 'bag')
    expected = [Speed(10**18, 5.0), Speed(10**18 + 100, -2.0)]
    assert reader.speeds('wheels/odom') == reader.speeds('/wheels/odom') == expected
    for topic in ('/odom', '/camera/image/ffmpeg'):
        with pytest.raises(UsageError, match=f'no topic {topic} of type .*here: /wheels/odom'):
            reader.speeds(topic)


def test_the_nearest_calibration_is_taken(tmp_path):
    other = Camera(64, 48, np.diag((2.0, 2.0, 1.0)) @ CAMERA.K)
    with BagWriter(tmp_path / 'bag') as writer:
        for topic, camera in (('/left/camera_info', CAMERA), ('/right/camera_info', other)):
            writer.write(topic, 'sensor_msgs/msg/CameraInfo',
                         fields.camera_to_fields(camera, 0, 'eye'), 0)
        fill(writer, ['/right/image/ffmpeg'])
    reader = BagReader(tmp_path / 'bag')
    assert reader.camera('/right/image/ffmpeg').K[0, 0] == other.K[0, 0]


@pytest.mark.parametrize(('video', 'info', 'is_beside'), [
    ('/camera/image_raw', '/camera/camera_info', True),
    ('/camera/image_raw/ffmpeg', '/camera/camera_info', True),
    ('/camera/image/compressed', '/camera/camera_info', True),
    ('/video', '/camera_info', True),
    ('/camera/image_raw', '/other/camera_info', False),
    ('/camera/image_raw', '/camera_info', False),
    ('/left/image_raw/ffmpeg', '/right/camera_info', False)])
def test_a_calibration_that_is_not_beside_the_video_is_not_taken(tmp_path, video, info, is_beside):
    kind = IMAGE if video.endswith('raw') else FFMPEG_PACKET
    picture = {'header': fields.header(0, 'eye'), 'height': 1, 'width': 1, 'encoding': 'mono8',
               'is_bigendian': 0, 'step': 1, 'data': np.zeros(1, np.uint8)}
    with BagWriter(tmp_path / 'bag') as writer:
        writer.write(info, 'sensor_msgs/msg/CameraInfo', camera_info(), 0)
        writer.write(video, kind, picture if kind == IMAGE else
                     packet_to_fields(packet(0, 0), (64, 48), 0, 'eye'), 0)
    reader = BagReader(tmp_path / 'bag')
    if is_beside:
        assert reader.camera(video).width == 64
        return
    with pytest.raises(UnusableInput, match=f'no camera_info beside {video}; it has {info}, .*'
                                            '--camera'):
        reader.camera(video)


def test_messages_that_cannot_be_used_are_left_out_and_counted(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        for k, stamp in enumerate(STAMPS):
            values = packet_to_fields(packet(k, stamp), (64, 48), k, 'eye')
            empty = {**values, 'data': np.zeros(0, np.uint8)}
            writer.write('/some', FFMPEG_PACKET, empty if k in (2, 4) else values, stamp)
            writer.write('/none', FFMPEG_PACKET, empty, stamp)
            writer.write('/odom', 'nav_msgs/msg/Odometry',
                         odometry(stamp, np.nan if k == 3 else 2.0), stamp)
    reader = BagReader(tmp_path / 'bag')
    assert list(reader.packets('/some')) == [packet(k, stamp) for k, stamp in enumerate(STAMPS)
                                             if k not in (2, 4)]
    assert reader.speeds('/odom') == [Speed(stamp, 2.0) for k, stamp in enumerate(STAMPS)
                                      if k != 3]
    some, odom = reader.skipped
    assert some.startswith('topic /some: 2 of its messages cannot be used and are left out; of '
                           'the first: data is empty')
    assert 'topic /odom: 1 of its messages' in odom
    assert 'twist.twist.linear[0] = nan' in odom
    with pytest.raises(UnusableInput, match='none of the 7 messages of topic /none can be used; '
                                            'of the first: data is empty'):
        list(reader.packets('/none'))


def camera_info(**changes):
    return {**fields.camera_to_fields(CAMERA, 0, 'eye'), **changes}


def write_infos(path, infos):
    with BagWriter(path) as writer:
        for i, info in enumerate(infos):
            writer.write('/camera/camera_info', 'sensor_msgs/msg/CameraInfo', info, i)
        fill(writer)
    return BagReader(path)


def test_the_first_usable_calibration_is_taken(tmp_path):
    none = camera_info(k=np.zeros(9))
    reader = write_infos(tmp_path / 'a', [none, camera_info(width=0), camera_info()])
    np.testing.assert_array_equal(reader.camera('/camera/image/ffmpeg').K, CAMERA.K)
    reader = write_infos(tmp_path / 'b', [none, camera_info(width=0)])
    with pytest.raises(UnusableInput, match='b: none of the 2 messages of topic /camera/camera_in'
                                            'fo can be used; of the first: .* not calibrated'):
        reader.camera('/camera/image/ffmpeg')


def test_a_binned_camera_is_that_of_the_pictures_as_published(tmp_path):
    roi = {'x_offset': 4, 'y_offset': 8, 'width': 40, 'height': 32, 'do_rectify': False}
    reader = write_infos(tmp_path / 'bag', [camera_info(binning_x=2, binning_y=2, roi=roi)])
    camera = reader.camera('/camera/image/ffmpeg')
    assert (camera.width, camera.height) == (20, 16)
    np.testing.assert_array_equal(camera.K, [[25, 0, 13.75], [0, 25, 7.75], [0, 0, 1]])


def test_log_times_never_go_back(bag):
    with AnyReader([bag]) as reader:
        times = [time for _, time, _ in reader.messages()]
        kinds = {c.topic: c.ext.offered_qos_profiles[0].durability.name
                 for c in reader.connections}
    assert times == sorted(times)
    assert len(set(times)) == len(times)
    assert kinds == {'/camera/camera_info': 'TRANSIENT_LOCAL', '/camera/image/ffmpeg': 'VOLATILE'}


def test_a_cut_bag_gives_what_is_whole(tmp_path):
    with McapFile(tmp_path / 'a.mcap') as writer:
        for _ in range(3):
            fill(writer)
            writer.write('/noise', 'std_msgs/msg/UInt8MultiArray', {
                'layout': {'dim': [], 'data_offset': 0},
                'data': np.random.default_rng(0).integers(0, 256, 2**20)}, 0)
    whole = (tmp_path / 'a.mcap').read_bytes()
    (tmp_path / 'cut.mcap').write_bytes(whole[:len(whole) // 2])
    reader = BagReader(tmp_path / 'cut.mcap')
    n_packets = len(list(reader.packets(reader.video_topic())))
    assert reader.is_cut
    assert n_packets in (len(STAMPS), 2 * len(STAMPS))


def test_sqlite_of_a_recorder_that_was_killed_is_read_without_its_metadata(bag, tmp_path):
    topics = ['/camera/camera_info', '/camera/image/ffmpeg']
    path = tmp_path / 'killed'
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        known = {}
        for raw, _ in BagReader(bag).messages(topics):
            known[raw.topic] = known.get(raw.topic) or writer.add_connection(
                raw.topic, raw.type, typestore=typestore())
            writer.write(known[raw.topic], raw.stamp, raw.data)
    assert not BagReader(path).is_cut
    (path / 'metadata.yaml').unlink()
    assert is_bag(path)
    reader = BagReader(path)
    assert reader.is_cut
    assert len(list(reader.packets(reader.video_topic()))) == len(STAMPS)
    assert reader.camera(reader.video_topic()).width == CAMERA.width
    with open_input(str(path)) as video:
        assert 'has no end' in video.warning


def test_a_file_is_replaced_only_when_it_is_whole(tmp_path):
    path = tmp_path / 'a.mcap'
    path.write_text('old')
    writer = McapFile(path)
    fill(writer)
    assert path.read_text() == 'old'
    writer.close()
    assert sorted(tmp_path.iterdir()) == [path]
    assert BagReader(path).counts == {'/camera/image/ffmpeg': len(STAMPS)}


def test_what_a_crash_left_behind_gives_way(tmp_path):
    fill(McapFile(tmp_path / 'a.mcap'))  # never closed
    with McapFile(tmp_path / 'a.mcap') as writer:
        fill(writer)
    assert BagReader(tmp_path / 'a.mcap').topics == {'/camera/image/ffmpeg': FFMPEG_PACKET}


@pytest.mark.parametrize('left', [(), ('metadata.yaml',)], ids=['before', 'after'])
def test_a_crash_may_leave_a_folder_without_the_file(tmp_path, left):
    (tmp_path / 'a').mkdir()  # killed before the file was made, or once it was in its place
    for name in left:
        (tmp_path / 'a' / name).touch()
    with McapFile(tmp_path / 'a.mcap') as writer:
        fill(writer)
    assert list(tmp_path.iterdir()) == [tmp_path / 'a.mcap']


def test_a_folder_that_holds_other_things_stays(tmp_path):
    (tmp_path / 'a').mkdir()
    (tmp_path / 'a' / 'mine.txt').touch()
    with pytest.raises(UsageError, match='exists already'):
        McapFile(tmp_path / 'a.mcap')
    assert (tmp_path / 'a' / 'mine.txt').exists()


def test_the_same_messages_make_the_same_file(tmp_path):
    for name in ('a', 'b'):
        (tmp_path / name).mkdir()
        with McapFile(tmp_path / name / 'c.mcap') as writer:
            fill(writer)
    assert (tmp_path / 'a/c.mcap').read_bytes() == (tmp_path / 'b/c.mcap').read_bytes()


def test_an_existing_bag_is_not_overwritten(bag):
    with pytest.raises(UsageError, match='exists already'):
        BagWriter(bag)


def test_of_several_videos_one_must_be_named(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        fill(writer, ['/left', '/right'])
    reader = BagReader(tmp_path / 'bag')
    with pytest.raises(UsageError, match='--topic: /left, /right'):
        reader.video_topic()
    assert reader.video_topic('right') == '/right'
    with pytest.raises(UsageError, match='no topic /up; it has /left, /right'):
        reader.video_topic('/up')


def test_a_bag_without_video_lists_what_it_has(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        writer.write('/info', 'sensor_msgs/msg/CameraInfo',
                     fields.camera_to_fields(CAMERA, 0, 'eye'), 0)
    reader = BagReader(tmp_path / 'bag')
    with pytest.raises(UnusableInput, match=r'no video topic; it has /info \(sensor_msgs'):
        reader.video_topic()
    with pytest.raises(UsageError, match='sensor_msgs/msg/CameraInfo, which is no video'):
        reader.video_topic('/info')


def test_what_is_no_bag_is_refused(tmp_path):
    (tmp_path / 'a.mcap').write_text('not a bag')
    (tmp_path / 'a.bag').write_text('#ROSBAG V2.0')
    with pytest.raises(UnusableInput, match='no such bag'):
        BagReader(tmp_path / 'b.mcap')
    with pytest.raises(UnusableInput, match='cannot be read as a bag'):
        BagReader(tmp_path / 'a.mcap')
    with pytest.raises(UnusableInput, match='rosbags-convert'):
        BagReader(tmp_path / 'a.bag')
    (tmp_path / 'empty').mkdir()
    assert not is_bag(tmp_path / 'empty')
    assert not is_bag(tmp_path / 'a.mp4')

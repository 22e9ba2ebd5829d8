"""Video messages as packets or pictures; shared by the ROS nodes and the bag reader.

Messages are read by their attributes, so it does not matter whose classes they are.
"""

from typing import Any

import cv2
from mv_slapse.codec import bitstream
from mv_slapse.codec.packet import Packet, Picture
from mv_slapse.errors import UnusableInput
from mv_slapse.fields import Fields, header, stamp_from_message, stamp_to_fields
from mv_slapse.message_checks import count, InvalidMessage, size
from mv_slapse.picture_size import size_of_still, STILLS
from mv_slapse.raw_images import picture_of
import numpy as np

FFMPEG_PACKET = 'ffmpeg_image_transport_msgs/msg/FFMPEGPacket'
COMPRESSED_VIDEO = 'foxglove_msgs/msg/CompressedVideo'
COMPRESSED_IMAGE = 'sensor_msgs/msg/CompressedImage'
IMAGE = 'sensor_msgs/msg/Image'
VIDEO_TYPES = (FFMPEG_PACKET, COMPRESSED_VIDEO, COMPRESSED_IMAGE, IMAGE)

DECODERS = {'264': 'h264', 'avc': 'h264', '265': 'hevc', 'hevc': 'hevc', 'vp9': 'vp9',
            'vp8': 'vp8', 'av1': 'av1', 'mpeg2': 'mpeg2video', 'mpeg1': 'mpeg1video',
            'mpeg4': 'mpeg4', 'xvid': 'mpeg4', 'jpeg': 'mjpeg'}
MAX_BYTES = 2**26  # of a coded picture; one of 64 million pixels has as many
HEVC_KEYS = range(16, 24)  # types of NAL units of pictures at which decoding may begin
STILL_FORMATS = ('jpeg', 'jpg', 'png')


def from_message(message_type: str, msg: Any) -> Packet | Picture:
    """Return what a message of one of VIDEO_TYPES carries.

    Raises
    ------
    UnusableInput
        Where the payload is none of the forms known for this type.
    """
    if message_type == IMAGE:
        return Picture(picture_of(msg), stamp_from_message(msg.header.stamp))
    data = _payload(msg)
    if message_type == FFMPEG_PACKET:
        stamp, name, flagged = msg.header.stamp, msg.encoding, bool(msg.flags & 1)
    elif message_type == COMPRESSED_VIDEO:
        stamp, name, flagged = msg.timestamp, msg.format, False
    else:
        stamp, name, flagged = msg.header.stamp, msg.format, False
        if _is_still(data, name):
            return Picture(_still_image(data, name), stamp_from_message(stamp))
    codec = bitstream.codec_of(data, decoder_of(name))
    return Packet(data, stamp_from_message(stamp), flagged or is_key(data, codec), codec)


def frame_of(message_type: str, msg: Any) -> str:
    """Return the camera's optical frame that a video message names."""
    return msg.frame_id if message_type == COMPRESSED_VIDEO else msg.header.frame_id


def packet_to_fields(packet: Packet, size: tuple[int, int], number: int, frame_id: str) -> Fields:
    """Return ffmpeg_image_transport_msgs/FFMPEGPacket; ``number`` counts the packets."""
    return {'header': header(packet.stamp, frame_id), 'width': int(size[0]),
            'height': int(size[1]), 'encoding': packet.codec, 'pts': number,
            'flags': int(packet.is_key), 'is_bigendian': False,
            'data': np.frombuffer(in_band(packet), np.uint8)}


def compressed_to_fields(packet: Packet, frame_id: str) -> Fields:
    """Return foxglove_msgs/CompressedVideo of a packet of H.264."""
    return {'timestamp': stamp_to_fields(packet.stamp), 'frame_id': frame_id, 'format': 'h264',
            'data': np.frombuffer(in_band(packet), np.uint8)}


def in_band(packet: Packet) -> bytes:
    """Return the payload as a stream that can be joined at any key picture.

    Messages have no place for parameter sets: each key picture brings them along, and H.264
    from MP4 files becomes Annex B.
    """
    is_avcc = packet.codec == 'h264' and packet.extradata[:1] == b'\x01'
    data = _annex_b(packet) if is_avcc else packet.data
    if not packet.is_key or not packet.extradata:
        return data
    head = packet.extradata
    if is_avcc:
        head = b''.join(b'\0\0\0\1' + unit
                        for unit in bitstream.parameter_sets(packet.extradata))
    return data if head in data else head + data


def decoder_of(name: str) -> str:
    """Return FFmpeg's name of the decoder for an encoder's or a format's name.

    ``libx264``, ``h264_nvenc``, ``h265`` and, of ffmpeg_image_transport 3,
    ``h264;yuv420p;bgr8;bgr8``.
    """
    first = name.split(';')[0].strip().lower().replace('.', '')
    return next((decoder for part, decoder in DECODERS.items() if part in first), first)


def is_key(data: bytes, codec: str) -> bool:
    """Return whether decoding can begin at this picture."""
    if codec == 'h264':
        return any(unit[0] & 31 == bitstream.NAL_IDR or bitstream.is_recovery_point(unit)
                   for unit in bitstream.nal_units(data))
    if codec in ('mpeg2video', 'mpeg1video'):
        at = data.find(b'\0\0\1\0')  # picture_start_code; then 10 bits of order, 3 of type
        return at >= 0 and at + 5 < len(data) and data[at + 5] >> 3 & 7 == 1
    if codec == 'hevc':
        return any(unit[0] >> 1 & 63 in HEVC_KEYS for unit in bitstream.nal_units(data))
    if codec == 'vp9':  # frame_marker, two bits of profile, show_existing_frame, frame_type
        return data[0] >> 6 == 2 and not data[0] & 12
    if codec == 'vp8':
        return not data[0] & 1
    if codec == 'av1':  # a sequence header, alone or behind the temporal delimiter
        return data[0] >> 3 & 15 == 1 or data[:1] == b'\x12' and data[2:3] >= b'\x08' and (
            data[2] >> 3 & 15 == 1)
    if codec == 'mpeg4':
        at = data.find(b'\0\0\1\xb6')
        return at >= 0 and at + 4 < len(data) and data[at + 4] >> 6 == 0
    return False


def _annex_b(packet: Packet) -> bytes:
    data, n, at, units = packet.data, (packet.extradata[4] & 3) + 1, 0, []
    while at + n < len(data):
        size = int.from_bytes(data[at:at + n], 'big')
        units.append(b'\0\0\0\1' + data[at + n:at + n + size])
        at += n + size
    return b''.join(units)


def _payload(msg: Any) -> bytes:
    """Return the bytes of a coded picture, neither none nor too many."""
    if not len(msg.data):
        raise InvalidMessage('data is empty: a video message without a picture; the message is '
                             'dropped, correct its publisher')
    return bytes(count(msg.data, 'data', MAX_BYTES))


def _is_still(data: bytes, name: str) -> bool:
    """Return whether a CompressedImage is a still picture, whatever its format field says."""
    said = any(still in name.lower() for still in STILL_FORMATS)
    return data.startswith(STILLS) or said and not bitstream.sniff(data)


def _still_image(data: bytes, name: str) -> np.ndarray:
    told = size_of_still(data)  # before memory is taken for it
    image = cv2.imdecode(np.frombuffer(data, np.uint8),
                         cv2.IMREAD_COLOR) if told and size(*told) else None
    if image is None:
        raise UnusableInput(f'a CompressedImage says {name!r} but is no picture of it')
    return image

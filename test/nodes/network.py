"""Cameras of the network, on the loopback."""

from contextlib import contextmanager
import socket
from struct import pack
from threading import Thread
import time


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        return probe.getsockname()[1]


@contextmanager
def _server(port: int, talk, times: int, held: float):
    """Talk to so many that connect, one after another; hang up after some time [s]."""
    with socket.create_server(('127.0.0.1', port)) as server:
        def serve():
            for _ in range(times):
                connection, _ = server.accept()
                with connection:
                    talk(connection)
                    time.sleep(held)

        thread = Thread(target=serve, daemon=True)
        thread.start()
        yield thread


def camera(port: int, content: bytes, times: int = 1, held: float = 0.0):
    """Send a stream to so many that connect, one after another; hang up after some time [s]."""
    return _server(port, lambda connection: connection.sendall(content), times, held)


SDP = ('v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=camera\r\nc=IN IP4 127.0.0.1\r\nt=0 0\r\n'
       'm=video 0 RTP/AVP 33\r\na=control:track0\r\n')  # 33: MPEG-TS, RFC 3551


def rtsp_camera(port: int, content: bytes, times: int = 1, held: float = 0.0):
    """Send an MPEG-TS by RTSP (RFC 2326) over TCP to so many, one after another, and hang up."""
    def talk(connection):
        with connection.makefile('rwb') as stream:
            _answer(stream)
            for packet in _interleaved(content):
                stream.write(packet)
                stream.flush()

    return _server(port, talk, times, held)


def _answer(stream):
    """Answer requests up to PLAY."""
    extra = {'OPTIONS': 'Public: OPTIONS, DESCRIBE, SETUP, PLAY\r\n', 'PLAY': '',
             'SETUP': 'Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\n',
             'DESCRIBE': f'Content-Type: application/sdp\r\nContent-Length: {len(SDP)}\r\n'}
    method = ''
    while method != 'PLAY':
        method, *_ = stream.readline().decode().split()
        head = {}
        while line := stream.readline().decode().strip():
            name, _, value = line.partition(': ')
            head[name.lower()] = value
        stream.write((f'RTSP/1.0 200 OK\r\nCSeq: {head["cseq"]}\r\nSession: 1\r\n'
                      f'{extra[method]}\r\n{SDP if method == "DESCRIBE" else ""}').encode())
        stream.flush()


def _interleaved(content: bytes):
    """Yield RTP packets of seven MPEG-TS packets each, in RTSP's frames."""
    for number, at in enumerate(range(0, len(content), 7 * 188)):
        rtp = pack('>BBHII', 0x80, 33, number % 65536, 3000 * number, 1) + content[
            at:at + 7 * 188]
        yield pack('>cBH', b'$', 0, len(rtp)) + rtp

"""A camera of the network, on the loopback."""

from contextlib import contextmanager
import socket
from threading import Thread
import time


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        return probe.getsockname()[1]


@contextmanager
def camera(port: int, content: bytes, times: int = 1, held: float = 0.0):
    """Send a stream to so many that connect, one after another; hang up after some time [s]."""
    with socket.create_server(('127.0.0.1', port)) as server:
        def serve():
            for _ in range(times):
                connection, _ = server.accept()
                with connection:
                    connection.sendall(content)
                    time.sleep(held)

        thread = Thread(target=serve, daemon=True)
        thread.start()
        yield thread

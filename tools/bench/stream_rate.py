"""How fast one WebSocket stream of `brickyard serve` moves pages, beside what loopback itself moves. Part of tools/bench/serve.

The receiver reads into one buffer and throws away: it stands for the fastest client there could be. The limit of loopback
is a process that sends the same piece of memory over and over, 128 KiB a call, to the same receiver.
"""
import base64
import multiprocessing
import os
import re
import socket
import struct
import time

RECEIVE_BYTES = 1 << 20
SEND_BYTES = 128 << 10
MOST_PAGES = 65536  # of a wish: docs/protocol.md, "Limits"
CREDIT = 4 << 30


def varint(number):
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    out.append(number)
    return bytes(out)


def numberField(field, number):
    return varint(field << 3) + varint(number) if number else b""


def bytesField(field, content):
    return varint(field << 3 | 2) + varint(len(content)) + content


def message(field, content):
    """A message of the stream in a client's WebSocket frame, whose mask is all zeros."""
    header = bytesField(field, content)
    body = struct.pack("<I", len(header)) + header
    length = len(body)
    size = (bytes([0x80 | length]) if length < 126 else
            b"\xfe" + struct.pack(">H", length) if length < 1 << 16 else b"\xff" + struct.pack(">Q", length))
    return b"\x82" + size + bytes(4) + body


def wish(epoch, pages):
    listed = b"".join(
        bytesField(5, numberField(2, block) + numberField(3, node)) for block, node in pages)
    return message(4, numberField(1, epoch) + numberField(2, 1) + listed + numberField(7, CREDIT))


def connect(port, name):
    stream = socket.create_connection(("127.0.0.1", port), timeout=30)
    key = base64.b64encode(os.urandom(16)).decode()
    stream.sendall((f"GET /{name} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                    f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n").encode())
    answer = b""
    while b"\r\n\r\n" not in answer:
        some = stream.recv(4096)
        if not some:
            raise OSError("the server closed instead of making a WebSocket")
        answer += some
    if not answer.startswith(b"HTTP/1.1 101"):
        raise OSError(f"no WebSocket: {answer.splitlines()[0].decode()}")
    stream.sendall(message(1, numberField(1, 1)) + message(2, bytesField(1, name.encode())) +
                   message(3, numberField(1, 1)))
    return stream


def receiveFor(stream, seconds, on_bytes):
    """Bytes and seconds of a stretch of a stream that has begun."""
    buffer = memoryview(bytearray(RECEIVE_BYTES))
    total, begin = 0, time.monotonic()
    while (took := time.monotonic() - begin) < seconds:
        count = stream.recv_into(buffer)
        if count == 0:
            raise OSError("the stream ended while it was measured")
        total += count
        on_bytes(count)
    return total, took


def measureStream(process, port, subject, seconds):
    """Of one connection: bytes a second, and bytes a second of the server's processor time."""
    name = subject["paths"][0].split("/")[3]
    pages = [tuple(int(n) for n in re.search(r"/pages/(\d+)/(\d+)$", path).groups()) for path in subject["paths"]]
    # A gigabyte a wish, and the next before the last of it: the server never waits for us.
    count = int(min(MOST_PAGES, 2**30 // subject["mean_bytes"]))
    pages = [pages[i % len(pages)] for i in range(count)]
    renew_at = 0.9 * count * subject["mean_bytes"]
    state = {"epoch": 0, "since": 0}
    with connect(port, name) as stream:

        def ask():
            state["epoch"] += 1
            state["since"] = 0
            stream.sendall(wish(state["epoch"], pages))

        def onBytes(number):
            state["since"] += number
            if state["since"] >= renew_at:
                ask()

        ask()
        receiveFor(stream, 0.3, onBytes)
        before = process.cpuSeconds()
        total, took = receiveFor(stream, seconds, onBytes)
        cpu = process.cpuSeconds() - before
    return {"bytes_per_second": total / took, "bytes_per_core_second": total / cpu if cpu else None,
            "cores_busy": cpu / took}


def send(port, seconds, result):
    piece = bytes(SEND_BYTES)
    with socket.create_connection(("127.0.0.1", port)) as out:
        begin, total = time.monotonic(), 0
        try:
            while time.monotonic() - begin < seconds:
                out.sendall(piece)
                total += SEND_BYTES
        except OSError:
            pass
        result.put((total, time.process_time()))


def measureLoopback(seconds):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        result = multiprocessing.Queue()
        sender = multiprocessing.Process(target=send, args=(listener.getsockname()[1], seconds + 0.5, result))
        sender.start()
        stream, _ = listener.accept()
        with stream:
            receiveFor(stream, 0.3, lambda count: None)
            total, took = receiveFor(stream, seconds, lambda count: None)
        sent, cpu = result.get()
        sender.join()
    return {"bytes_per_second": total / took, "bytes_per_core_second": sent / cpu if cpu else None}

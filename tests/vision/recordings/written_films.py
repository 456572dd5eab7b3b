"""Films whose frames show their own number, at times that are known."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

SIZE = (96, 64)
"""Width and height [px]."""
BITS = 7
RATE = 148
TICK = Fraction(1, RATE * 100)
"""Unit of time [s] in which `write_film` takes times; a container may round it."""


def numbered(number: int) -> NDArray[np.uint8]:
    """An image with the bits of a number as bright and dark bars, over noise."""
    width, height = SIZE
    image = np.random.default_rng(number).integers(60, 120, (height, width), dtype=np.uint8)
    for bit in range(BITS):
        image[8:40, 4 + 13 * bit : 14 + 13 * bit] = 235 if number >> bit & 1 else 20
    return image


def number_in(image: NDArray[np.uint8]) -> int:
    """The number that an image shows."""
    bars = [float(image[12:36, 6 + 13 * bit : 12 + 13 * bit].mean()) for bit in range(BITS)]
    return sum((bar > 128) << bit for bit, bar in enumerate(bars))


def write_film(
    path: Path,
    ticks: Sequence[int] | NDArray[np.int64],
    *,
    codec: str = "libx264",
    b_frames: int = 0,
    gop: int = 12,
    turned: int = 0,
) -> Path:
    """Write frames 0, 1, 2... at times in units of `TICK`.

    Args:
        path: Its suffix says which container.
        ticks: When each frame is shown.
        codec: FFmpeg's name of the encoder.
        b_frames: Most frames between two that are shown before they could be decoded in order.
        gop: Frames from one keyframe to the next.
        turned: Degrees by which players turn the images, counterclockwise.
    """
    options = {"crf": "12", "preset": "ultrafast"}
    if codec == "libx265":
        options["x265-params"] = f"log-level=none:bframes={b_frames}:keyint={gop}"
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=RATE, options=options if codec.startswith("libx26") else {})
        stream.width, stream.height = SIZE
        stream.pix_fmt = "gray" if codec == "ffv1" else "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.codec_context.time_base = Fraction(1, RATE) if path.suffix == ".avi" else TICK
        stream.gop_size, stream.max_b_frames = gop, b_frames
        if turned:
            stream.set_display_rotation(turned)
        for number, at in enumerate(ticks):
            frame = av.VideoFrame.from_ndarray(numbered(number), "gray").reformat(format=stream.pix_fmt)
            frame.pts, frame.time_base = int(at), TICK
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def damage(path: Path, first: int, last: int) -> None:
    """Overwrite the packets of some frames of a film without B-frames with zeros."""
    with av.open(str(path)) as container:
        places = [(packet.pos, packet.size) for packet in container.demux(video=0) if packet.size]
    content = bytearray(path.read_bytes())
    for at, size in places[first:last]:
        content[at : at + size] = bytes(size)
    path.write_bytes(content)


STEADY = np.arange(60) * 100
LATE = {
    "constant": STEADY,
    "dropped": np.delete(np.arange(68), [9, 10, 11, 30, 31, 47, 50, 66]) * 100,
    "variable": np.concatenate([STEADY[:20], 2000 + 2 * STEADY[:20], 6000 + STEADY[:20]]),
    "jittered": STEADY + np.random.default_rng(1).integers(0, 60, 60) * (STEADY > 0),
    "offset": STEADY + 7_400,
}
"""When the frames of films of each kind are shown, in units of `TICK`."""

"""Small files that claim much: each is a few kilobytes (the largest 4 MiB), and asks a reader for gigabytes.

Each maker writes its files into an empty folder and gives the words of the command that has to refuse them.
"""

from __future__ import annotations

import bz2
import io
import sqlite3
import struct
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import h5py
import numpy as np
import torch
from rosbags.rosbag1 import Writer
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.store.makers import make_dataset
from tests.vision.bags import CAMERAS
from tests.vision.films import write_recording
from tossid.models import TrainedModel, build_model, variant
from tossid.objects import load_object
from tossid.settings.training import TrainSettings
from tossid.store import write_dataset
from tossid.store.schema import MEMBERS
from tossid.vision.recordings.npz import write_detections
from tossid.vision.setup.faces import default_tags
from tossid.vision.setup.layout import layout_of

MODEL = """<mujoco>{head}<worldbody><body name="base"><freejoint/><geom type="box" size="0.05 0.05 0.05"/>{inside}
</body></worldbody></mujoco>"""


@dataclass(frozen=True)
class Claim:
    """A hostile file.

    Attributes:
        make: Writes it into a folder, and gives the words of a command that reads it.
        names: The file that the error has to name.
        says: A part of what the error has to say.
    """

    make: Callable[[Path], list[str]]
    names: str
    says: str


def recording(folder: Path) -> Path:
    """A recording of one camera, whose one frame is no image yet."""
    cube = load_object("cube")
    write_recording(folder / "rec", CAMERAS[:1], layout_of(cube.with_changes(tags=default_tags(cube))), ())
    (folder / "rec" / "frames" / "left" / "1.png").write_bytes(b"")
    return folder / "rec"


def _layout(text: str) -> Callable[[Path], list[str]]:
    def make(folder: Path) -> list[str]:
        (recording(folder) / "tagslam.yaml").write_text(text)
        return ["info", "rec"]

    return make


BOARD = """bodies:
- b: {is_static: true, type: board, board: {tag_start_id: 0, tag_size: 1, tag_spacing: 0, tag_rows: 1.0e+5,
  tag_columns: 1.0e+5}}
"""
ALIASES = "".join(
    [
        "bodies:\n- x: &b {is_static: true, default_tag_size: 1, tags: [&t {id: 1}",
        ", *t" * 999,
        "]}\n",
        "- x: *b\n" * 999,
    ]
)


def _object(head: str = "", inside: str = "") -> Callable[[Path], list[str]]:
    def make(folder: Path) -> list[str]:
        write_dataset(make_dataset(load_object("cube")), folder / "a.h5")
        text = MODEL.format(head=head, inside=inside)
        with h5py.File(folder / "a.h5", "a") as file:
            del file["object/mjcf"]
            file["object/mjcf"] = np.frombuffer(text.encode(), dtype="|u1")
        return ["train", "data=a.h5"]

    return make


def _large_arrays(folder: Path) -> list[str]:
    """Arrays of zeros: 1 GB in 1 MB."""
    write_dataset(make_dataset(load_object("cube"), tosses=1), folder / "a.h5")
    rows, n = 1 << 14, 1 << 21
    with h5py.File(folder / "a.h5", "a") as file:
        toss = file["tosses/toss_0000"]
        for member in MEMBERS:
            if member.name not in toss:
                continue
            rest = toss[member.name].shape[1:]
            del toss[member.name]
            made = toss.create_dataset(
                member.name, (n, *rest), member.dtype, chunks=(rows, *rest), compression="gzip", shuffle=True
            )
            packed = zlib.compress(bytes(rows * int(np.prod(rest)) * made.dtype.itemsize), 9)
            for at in range(0, n, rows):
                made.id.write_direct_chunk((at, *(0 for _ in rest)), packed)
    return ["train", "data=a.h5"]


def _linked_arrays(folder: Path) -> list[str]:
    """A hundred tosses whose arrays are links to those of one, each of 20 MB."""
    write_dataset(make_dataset(load_object("cube"), tosses=1), folder / "a.h5")
    n, count = 50_000, 100
    with h5py.File(folder / "a.h5", "a") as file:
        toss = file["tosses/toss_0000"]
        for member in MEMBERS:
            if member.name in toss:
                rest = toss[member.name].shape[1:]
                del toss[member.name]
                toss.create_dataset(member.name, (n, *rest), member.dtype, compression="gzip", shuffle=True)
                toss[member.name][...] = np.zeros((n, *rest), member.dtype)
        for k in range(1, count):
            other = file["tosses"].create_group(f"toss_{k:04d}")
            for name, value in toss.attrs.items():
                other.attrs[name] = value
            other.attrs["index"] = k
            for name in toss:
                other[name] = toss[name]
        file.attrs["n_tosses"] = count
    return ["info", "a.h5"]


def _inflating_chunk(folder: Path) -> list[str]:
    """A chunk of 576 bytes whose stream inflates to 512 MB."""
    write_dataset(make_dataset(load_object("cube"), tosses=1), folder / "a.h5")
    packer, packed = zlib.compressobj(1), []
    packed = [packer.compress(bytes(1 << 24)) for _ in range(32)] + [packer.flush()]
    with h5py.File(folder / "a.h5", "a") as file:
        toss = file["tosses/toss_0000"]
        n = toss["t"].shape[0]
        del toss["t"]
        made = toss.create_dataset("t", (n,), "<f8", chunks=(n,), compression="gzip", shuffle=True)
        made.id.write_direct_chunk((0,), b"".join(packed))
    return ["train", "data=a.h5"]


def _heaps(folder: Path) -> list[str]:
    """131,072 heaps, each from its place to the end of the file."""
    write_dataset(make_dataset(load_object("cube"), tosses=1), folder / "a.h5")
    size = 1 << 22
    parts = [b"GCOL\x01\0\0\0" + struct.pack("<QH6xQ", size - at, 1, 16) for at in range(0, size - 32, 32)]
    parts.append(b"GCOL\x01\0\0\0" + struct.pack("<QH6xQ", 32, 1, 0))
    with (folder / "a.h5").open("ab") as file:
        file.write(b"".join(parts))
    return ["info", "a.h5"]


def _stride(folder: Path) -> list[str]:
    (folder / "pt").mkdir()
    torch.save(torch.zeros(1, 19, dtype=torch.float64).expand(10**9, 19), folder / "pt" / "0.pt")
    return ["ingest", "source=contactnets", "source.path=pt"]


def _pickled(folder: Path) -> list[str]:
    """A list of sixty million lists, for which a tensor is expected."""
    (folder / "pt").mkdir()
    with zipfile.ZipFile(folder / "pt" / "0.pt", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", b"\x80\x02](" + b"]" * (60 << 20) + b"e.")
        archive.writestr("archive/version", "3\n")
    return ["ingest", "source=contactnets", "source.path=pt"]


def _names(folder: Path) -> list[str]:
    """Detections whose list of cameras has a thousand million names of no length."""
    write_detections((), recording(folder) / "empty.npz")
    with zipfile.ZipFile(folder / "rec" / "empty.npz") as whole, zipfile.ZipFile(folder / "a.npz", "w") as archive:
        for name in whole.namelist():
            content = io.BytesIO(whole.read(name))
            if name == "cameras.npy":
                head = {"descr": "<U0", "fortran_order": False, "shape": (10**9,)}
                np.lib.format.write_array_header_2_0(content, head)
            archive.writestr(name, content.getvalue())
    return ["track", "recording=rec", "detections=a.npz"]


def checkpoint(folder: Path) -> None:
    """A small trained model, `model.pt`, whose settings say that its layers are 20,000 wide."""
    settings = TrainSettings(model=variant("cnrp"))
    TrainedModel(build_model(settings.model, load_object("cube")), settings, {}).save(folder / "model.pt")
    content = torch.load(folder / "model.pt", weights_only=True)
    content["settings"]["model"]["hidden"] = 20000
    torch.save(content, folder / "model.pt")


def _hidden(folder: Path) -> list[str]:
    (folder / "run").mkdir()
    checkpoint(folder)
    (folder / "model.pt").rename(folder / "run" / "checkpoint.pt")
    (folder / "run" / "config.yaml").write_text("model: {name: cnrp}\ndata: a.h5\n")
    write_dataset(make_dataset(load_object("cube")), folder / "a.h5")
    return ["evaluate", "run=run", "data=a.h5"]


def _packed_bag(folder: Path) -> list[str]:
    recording(folder)
    (folder / "a.bag.bz2").write_bytes(bz2.compress(bytes(1 << 26)) * 33)
    return ["ingest", "source=rosbag", "source.path=a.bag.bz2", "source.set_up=rec", "object=cube"]


def _strings(folder: Path) -> list[str]:
    recording(folder)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg("string[1000000] x\n", "apriltag_msgs/msg/Lots"))
    with Writer(folder / "a.bag") as writer:
        made = writer.add_connection(CAMERAS[0].tag_topic, "apriltag_msgs/msg/Lots", typestore=store)
        writer.write(made, 10**9, bytes(16))
    return ["ingest", "source=rosbag", "source.path=a.bag", "source.set_up=rec", "object=cube"]


def _record(fields: dict[str, bytes], data: bytes) -> bytes:
    parts = [name.encode() + b"=" + value for name, value in fields.items()]
    header = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def _chunk(folder: Path) -> list[str]:
    """A chunk of a bag without index: 96 MB in a hundred bytes."""
    recording(folder)
    chunk = {"op": b"\x05", "compression": b"bz2", "size": struct.pack("<I", 0x7FFFFFFF)}
    (folder / "a.bag").write_bytes(b"#ROSBAG V2.0\n" + _record(chunk, bz2.compress(bytes(96 << 20))))
    return ["ingest", "source=rosbag", "source.path=a.bag", "source.set_up=rec", "object=cube"]


def _chunks(folder: Path) -> list[str]:
    """A thousand chunks of 30 MB, packed to 49 bytes each."""
    recording(folder)
    head = {"op": b"\x05", "compression": b"bz2", "size": struct.pack("<I", 30 << 20)}
    chunk = _record(head, bz2.compress(bytes(30 << 20)))
    (folder / "a.bag").write_bytes(b"#ROSBAG V2.0\n" + chunk * 1000)
    return ["ingest", "source=rosbag", "source.path=a.bag", "source.set_up=rec", "object=cube"]


ENDLESS = """DROP TABLE message_definitions;
CREATE VIEW message_definitions AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c)
SELECT '' AS topic_type, 'ros2msg' AS encoding, '' AS encoded_message_definition, '' AS type_description_hash, x AS id
FROM c;"""
COMPUTED = """DROP TABLE messages;
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data AS (zeroblob(900000000)));
INSERT INTO messages(topic_id, timestamp) SELECT id, 1 FROM topics;"""


def _database(script: str) -> Callable[[Path], list[str]]:
    """A ROS 2 bag whose database computes what it holds."""

    def make(folder: Path) -> list[str]:
        recording(folder)
        store = get_typestore(Stores.ROS2_HUMBLE)
        with Writer2(folder / "bag", version=9) as writer:
            image = writer.add_connection(CAMERAS[0].image_topic, "sensor_msgs/msg/Image", typestore=store)
            writer.write(image, 10**9, bytes(16))
        with sqlite3.connect(folder / "bag" / "bag.db3") as database:
            database.executescript(script)
        database.close()
        return ["ingest", "source=rosbag", "source.path=bag", "source.set_up=rec", "object=cube"]

    return make


def _png(folder: Path) -> list[str]:
    def part(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", 32000, 32000, 1, 0, 0, 0, 0)
    packer = zlib.compressobj(9)
    rows = b"".join([*(packer.compress(bytes(4001 * 1000)) for _ in range(32)), packer.flush()])
    content = b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + part(b"IDAT", rows) + part(b"IEND", b"")
    (recording(folder) / "frames" / "left" / "1.png").write_bytes(content)
    return ["detect", "recording=rec"]


def _png_chunk(folder: Path) -> list[str]:
    image = cv2.imencode(".png", np.zeros((24, 32), np.uint8))[1].tobytes()
    at = image.index(b"IDAT") - 4
    content = image[:at] + struct.pack(">I", 954_000_000) + image[at + 4 :]
    (recording(folder) / "frames" / "left" / "1.png").write_bytes(content)
    return ["detect", "recording=rec"]


def _scans(folder: Path) -> list[str]:
    """A progressive JPEG of 49 million pixels that is scanned 2,000 times."""

    def part(marker: int, data: bytes) -> bytes:
        return bytes([0xFF, marker]) + struct.pack(">H", len(data) + 2) + data

    head = part(0xDB, bytes([0, *[1] * 64])) + part(0xC2, struct.pack(">BHHB", 8, 7000, 7000, 1) + bytes([1, 0x11, 0]))
    head += part(0xC4, bytes([0x00, 1, *[0] * 15, 0x00])) + part(0xC4, bytes([0x10, 1, *[0] * 15, 0xE0]))
    blocks = 875 * 875
    scans = [part(0xDA, bytes([1, 1, 0, 0, 0, 0])) + bytes(blocks // 8 + 1)]
    scans += [part(0xDA, bytes([1, 1, 0, 1 + k % 60, 1 + k % 60, 0])) + bytes(90) for k in range(2000)]
    content = b"\xff\xd8" + head + b"".join(scans) + b"\xff\xd9"
    (recording(folder) / "frames" / "left" / "1.png").write_bytes(content)
    return ["detect", "recording=rec"]


def _model_of_recording(folder: Path) -> list[str]:
    rec = recording(folder)
    (rec / "object.yaml").write_text("name: a\npath: object.xml\nfriction: 0.2\nrestitution: 0.0\n")
    inside = '<replicate count="1000"><replicate count="1000"><geom size="1"/></replicate></replicate>'
    (rec / "object.xml").write_text(MODEL.format(head="", inside=inside))
    return ["info", "rec"]


CLAIMS: dict[str, Claim] = {
    "board": Claim(_layout(BOARD), "tagslam.yaml", "claims 10,000,000,000 tags"),
    "aliases": Claim(_layout(ALIASES), "tagslam.yaml", "with all that its aliases repeat"),
    "values": Claim(_layout("bodies: [" + "1," * 131_000 + "]"), "tagslam.yaml", "claims more than 40,000 values"),
    "replicate": Claim(_object(inside='<replicate count="100000000"><geom size="1"/></replicate>'), "a.h5", "elements"),
    "flexcomp": Claim(
        _object(inside='<flexcomp name="f" type="grid" count="1000 1000 1000" spacing="1 1 1"/>'),
        "a.h5",
        "element <flexcomp>",
    ),
    "texture": Claim(
        _object('<asset><texture name="t" type="2d" builtin="flat" width="40000" height="40000"/></asset>'),
        "a.h5",
        "pixels of textures",
    ),
    "textures": Claim(
        _object("<asset>" + '<texture type="2d" builtin="flat" width="2800" height="2800"/>' * 9 + "</asset>"),
        "a.h5",
        "claims 94080000 pixels of textures",
    ),
    "keys": Claim(_object('<size nkey="200000000"/>'), "a.h5", "claims 200000000 'nkey'"),
    "object.xml": Claim(_model_of_recording, "object.xml", "elements"),
    "hdf5 arrays": Claim(_large_arrays, "a.h5", "bytes of"),
    "hdf5 chunk": Claim(_inflating_chunk, "a.h5", "inflates to more than"),
    "hdf5 links": Claim(_linked_arrays, "a.h5", "bytes of tosses"),
    "hdf5 heaps": Claim(_heaps, "a.h5", "overlap"),
    "stride 0": Claim(_stride, "0.pt", "claims a tensor of shape (1000000000, 19)"),
    "pickle": Claim(_pickled, "0.pt", "bytes of values beside its tensors"),
    "names": Claim(_names, "a.npz", "claims 1,000,000,000 cameras"),
    "hidden": Claim(_hidden, "checkpoint.pt", "hidden: 20000 is out of range"),
    "bag.bz2": Claim(_packed_bag, "a.bag.bz2", "bytes when unpacked"),
    "bag strings": Claim(_strings, "a.bag", "claims 1,000,00"),
    "bag chunk": Claim(_chunk, "a.bag", "when unpacked"),
    "bag chunks": Claim(_chunks, "a.bag", "its chunks claim"),
    "bag view": Claim(_database(ENDLESS), "bag", "its view 'message_definitions' is computed"),
    "bag column": Claim(_database(COMPUTED), "bag", "its table 'messages' is computed"),
    "png": Claim(_png, "1.png", "claims 1,024,000,000 pixels (32000 by 32000)"),
    "png chunk": Claim(_png_chunk, "1.png", "claims 954,000,000 bytes"),
    "jpeg": Claim(_scans, "1.png", "pixels in its 2001 scans"),
}

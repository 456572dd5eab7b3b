"""Files between the stages: detections and tracks as `.npz`, written whole or not at all."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tossid import budget
from tossid.errors import FileError, MotionError
from tossid.outputs import output_stream
from tossid.types import Detection, PoseTrack

DETECTIONS = "tossid.detections/2"
DETECTIONS_1 = "tossid.detections/1"
"""As before, with one covariance (2, 2) for a tag's four corners."""
TRACKS = "tossid.tracks/1"
_TEXT, _COUNT, _NUMBER = "U", "iu", "f"
_KINDS = {_TEXT: "text", _COUNT: "integers", _NUMBER: "floating-point numbers"}
Layout = Mapping[str, tuple[str, tuple[int | str, ...]]]
"""Kind of each array's values, and its shape; a length by a name is the same wherever it has that name."""
_DETECTIONS: Layout = {
    "schema": (_TEXT, ()),
    "cameras": (_TEXT, ("cameras",)),
    "camera": (_COUNT, ("n",)),
    "t": (_NUMBER, ("n",)),
    "tag_id": (_COUNT, ("n",)),
    "corners": (_NUMBER, ("n", 4, 2)),
    "corner_cov": (_NUMBER, ("n", 4, 2, 2)),
    "hamming": (_COUNT, ("n",)),
    "margin": (_NUMBER, ("n",)),
}
_DETECTIONS_1 = {**_DETECTIONS, "corner_cov": (_NUMBER, ("n", 2, 2))}
_TRACKS: Layout = {
    "schema": (_TEXT, ()),
    "names": (_TEXT, ("tracks",)),
    "lengths": (_COUNT, ("tracks",)),
    "t": (_NUMBER, ("n",)),
    "q": (_NUMBER, ("n", "nq")),
    "q_cov": (_NUMBER, ("n", "nv", "nv")),
}


def write_detections(detections: Iterable[Detection], path: str | Path) -> None:
    """Write detections: arrays camera (index into `cameras`), t, tag_id, corners, corner_cov, hamming, margin."""
    rows = list(detections)
    names = sorted({row.camera for row in rows})
    index = {name: i for i, name in enumerate(names)}
    _write(
        Path(path),
        schema=np.array(DETECTIONS),
        cameras=np.array(names, dtype=str),
        camera=np.array([index[row.camera] for row in rows], dtype=np.int32),
        t=np.array([row.t for row in rows], dtype=float),
        tag_id=np.array([row.tag_id for row in rows], dtype=np.int32),
        corners=np.array([row.corners for row in rows], dtype=float).reshape(-1, 4, 2),
        corner_cov=np.array([row.corner_cov for row in rows], dtype=float).reshape(-1, 4, 2, 2),
        hamming=np.array([row.hamming for row in rows], dtype=np.int32),
        margin=np.array([row.margin for row in rows], dtype=float),
    )


def read_detections(path: str | Path) -> tuple[Detection, ...]:
    """Read what `write_detections` wrote, now or as `DETECTIONS_1`. `FileError` on anything else."""
    path = Path(path)
    data = _read(path, {DETECTIONS: _DETECTIONS, DETECTIONS_1: _DETECTIONS_1})
    n, old = len(data["t"]), str(data["schema"]) == DETECTIONS_1
    budget.check_claim(path, "cameras", len(data["cameras"]), budget.limits().cameras)
    names = [str(name) for name in data["cameras"]]
    if n and not (data["camera"].min() >= 0 and data["camera"].max() < len(names)):
        raise FileError(path, "camera indices do not fit the list of cameras")
    for key in ("t", "corners", "corner_cov"):
        bad = ~np.isfinite(data[key]).all(axis=tuple(range(1, data[key].ndim)))
        if bad.any():
            raise FileError(path, f"{key} is not finite", row=int(np.argmax(bad)))
    cov = np.repeat(data["corner_cov"][:, None], 4, axis=1) if old else data["corner_cov"]
    return tuple(
        Detection(
            names[int(data["camera"][i])],
            float(data["t"][i]),
            int(data["tag_id"][i]),
            data["corners"][i],
            cov[i],
            int(data["hamming"][i]),
            float(data["margin"][i]),
        )
        for i in range(n)
    )


def write_tracks(tracks: Sequence[PoseTrack], path: str | Path) -> None:
    """Write tracks one after another: arrays names, lengths, t, q, q_cov (NaN where there is none)."""
    nq = tracks[0].q.shape[1] if tracks else 7
    covs = [np.full((len(track.t), nq - 1, nq - 1), np.nan) if track.q_cov is None else track.q_cov for track in tracks]
    _write(
        Path(path),
        schema=np.array(TRACKS),
        names=np.array([track.name for track in tracks], dtype=str),
        lengths=np.array([len(track.t) for track in tracks], dtype=np.int64),
        t=np.concatenate([track.t for track in tracks] or [np.zeros(0)]),
        q=np.concatenate([track.q for track in tracks] or [np.zeros((0, nq))]),
        q_cov=np.concatenate([*covs] or [np.zeros((0, nq - 1, nq - 1))]),
    )


def read_tracks(path: str | Path) -> tuple[PoseTrack, ...]:
    """Read what `write_tracks` wrote. `FileError` on anything else."""
    path = Path(path)
    data = _read(path, {TRACKS: _TRACKS})
    lengths, n = data["lengths"].astype(np.int64), len(data["t"])
    if not ((lengths >= 0) & (lengths <= n)).all() or lengths.sum() != n:
        raise FileError(path, "the tracks' lengths do not fit its times")
    tracks = []
    for name, end, length in zip(data["names"], np.cumsum(lengths), lengths, strict=True):
        own = slice(int(end - length), int(end))
        cov = data["q_cov"][own]
        try:
            tracks.append(PoseTrack(str(name), data["t"][own], data["q"][own], None if np.isnan(cov).all() else cov))
        except MotionError as error:
            raise FileError(path, f"track '{name}': {error}") from error
    return tuple(tracks)


def _write(path: Path, **arrays: Any) -> None:
    with output_stream(path) as stream:
        np.savez_compressed(stream, **arrays)


def _read(path: Path, schemas: Mapping[str, Layout]) -> dict[str, np.ndarray]:
    """The arrays of a file of one of the schemas, as its layout has them."""
    expected = next(iter(schemas))
    try:
        budget.check_archive(path)
        with np.load(path, allow_pickle=False) as archive:
            data = {key: archive[key] for key in archive.files}
            stored = {key: archive.zip.getinfo(f"{key}.npy").file_size for key in data}
    except FileError:
        raise
    except Exception as error:  # of a damaged archive, zipfile, zlib and numpy raise whatever they come across
        raise FileError(path, f"is not a whole {expected} file") from error
    layout = schemas.get(str(data.get("schema")))
    if layout is None:
        raise FileError(path, f"holds {data.get('schema', 'nothing')}, expected {expected}")
    missing = [key for key in layout if key not in data]
    if missing:
        raise FileError(path, f"has no {', '.join(missing)}")
    lengths = dict[int | str, int]()
    for key, (kind, shape) in layout.items():
        array = data[key]  # numpy gives the bytes of what is no array
        if not isinstance(array, np.ndarray) or array.dtype.kind not in kind:
            raise FileError(path, f"{key} holds {getattr(array, 'dtype', 'bytes')}, expected {_KINDS[kind]}")
        if array.nbytes > stored[key]:  # of text of no length, NumPy makes text of one letter
            raise FileError(path, f"{key} claims {array.size:,} values, more than its {stored[key]} bytes can hold")
        known = len(array.shape) == len(shape) and all(
            size == (length if isinstance(length, int) else lengths.setdefault(length, size))
            for length, size in zip(shape, array.shape, strict=True)
        )
        if not known:
            wanted = ", ".join(str(lengths.get(length, length)) for length in shape)
            raise FileError(path, f"{key} has shape {array.shape}, expected ({wanted})")
    return data

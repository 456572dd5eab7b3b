"""AprilTag detection in a recording: where to search, which tags to accept, corners and their covariance."""

from __future__ import annotations

import contextlib
import ctypes
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pupil_apriltags import Detector

from tossid.errors import InputError, ObjectError
from tossid.objects import ObjectModel
from tossid.settings.ingestion import DetectSettings
from tossid.types import Detection, Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.detection.corners import refine_corners
from tossid.vision.detection.occlusion import hidden_edges
from tossid.vision.detection.search_regions import Predictor
from tossid.vision.recordings.recording import FrameFile, Recording
from tossid.vision.setup.layout import DEFAULT_FAMILY, FAMILIES, TagLayout

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

TILE = 4
"""The AprilTag library's threshold is set by tiles of this many pixels."""
DAMAGED = "damaged frames"
"""Counts frames of films that cannot be decoded."""
DEFAULT = DetectSettings()
UNREFINED_SIGMA = 0.4
"""Standard deviation of a corner as the AprilTag library gives it [px]; measured on rendered tags."""
BORDER = 2.0
"""Least distance from the image's border of a corner that is not refined [px]; nearer ones are extrapolated."""
HIDDEN_SIGMA, BESIDE_HIDDEN = 0.5, 0.2
"""Standard deviation, in cells, of corners at an edge that something lies against, and of a tag whose edges could not
be fitted; and the share of it that the tag's other corners get."""
FINE_SEARCH = 4
"""Of this many frames in a row without a tag, one is searched whole at full resolution."""
BATCH = 96
"""Frames of one camera that are searched in one go; bounds the memory."""


class TagFinder:
    """Finds an object's tags in the images of one camera, one after another.

    After a frame in which tags were seen, the next is searched only where the object must be by these tags and their
    velocity; where that finds nothing, and at first, the whole image is searched.
    """

    def __init__(
        self,
        camera: Camera,
        model: ObjectModel | None,
        settings: DetectSettings = DEFAULT,
        layout: TagLayout | None = None,
    ) -> None:
        """Look for tags in the images of a camera.

        Args:
            camera: Whose images they are.
            model: The object, with its tags; None for a scene of any tags, whose images are then searched whole.
            settings: How tags are looked for.
            layout: Says which families the tags are of; None: all are 36h11.
        """
        self.camera = camera
        self.tag_ids = frozenset(tag.id for tag in model.tags) if model is not None else None
        self.settings = settings
        self._usual = layout.tag_family if layout is not None else DEFAULT_FAMILY
        self._family = layout.families if layout is not None else {}
        ids = self._family if self.tag_ids is None else self.tag_ids
        names = {self._family.get(tag_id, self._usual) for tag_id in ids}
        self._families = tuple(sorted(names | {self._usual} if self.tag_ids is None else names))
        self.tally: Counter[str] = Counter()  # of what was rejected, by reason, and of how often was searched where
        self._predictor = Predictor(camera, model) if model is not None and settings.predict else None
        self._lost = 0  # whole-image searches since tags were last seen

    def find(self, frame: Frame) -> list[Detection]:
        """Detections in the next frame."""
        if self._predictor is None:
            self.tally["searched the whole image"] += 1
            found = self._search(frame, (0, 0), frame.image, self.settings.quad_decimate, count=True)
        else:
            found = self._near(frame, self._predictor)
            if not found:
                found = self._everywhere(frame)
                if found:
                    self._predictor.see(frame.t, found)
                    found = self._near(frame, self._predictor) or found
            if found:
                self._lost = 0
                self._predictor.see(frame.t, found)
            else:
                self._predictor.forget()
        self.tally["tags"] += len(found)
        self.tally["frames without a tag"] += not found
        return found

    def _everywhere(self, frame: Frame) -> list[Detection]:
        """Search the whole image coarsely; at first and now and then finely, as small tags need."""
        self.tally["searched the whole image"] += 1
        fine = self._lost % FINE_SEARCH == 0
        self._lost += 1
        coarse = self.settings.search_decimate > self.settings.quad_decimate
        seen = self._search(frame, (0, 0), frame.image, self.settings.search_decimate, count=False)
        if not seen and fine and coarse:
            self.tally["searched the whole image finely"] += 1
            seen = self._search(frame, (0, 0), frame.image, self.settings.quad_decimate, count=False)
        return seen

    def _near(self, frame: Frame, predictor: Predictor) -> list[Detection]:
        """Search where the object must be."""
        box = predictor.box(frame.t)
        if box is None:
            return []
        x0, y0, x1, y1 = box
        x0, y0 = x0 - x0 % TILE, y0 - y0 % TILE  # then the library finds in the part what it finds in the whole
        self.tally["searched where predicted"] += 1
        part = np.ascontiguousarray(frame.image[y0:y1, x0:x1])
        return self._search(frame, (x0, y0), part, self.settings.quad_decimate, count=True)

    def _search(
        self, frame: Frame, origin: tuple[int, int], image: Image, decimate: float, *, count: bool
    ) -> list[Detection]:
        rejected: Counter[str] = Counter()
        accepted: dict[int, list[Any]] = {}
        with tag_detector(self._families, decimate, self.settings.min_margin) as detector:
            seen = detector.detect(image)
        for raw in seen:
            if self.tag_ids is not None and raw.tag_id not in self.tag_ids:
                rejected["rejected: id not on the object"] += 1
            elif raw.tag_family.decode() != self._family.get(raw.tag_id, self._usual):
                rejected["rejected: id of another family"] += 1
            elif raw.hamming > self.settings.max_hamming:
                rejected["rejected: too many corrected bits"] += 1
            elif raw.decision_margin < self.settings.min_margin:
                rejected["rejected: weak decision margin"] += 1
            else:
                accepted.setdefault(raw.tag_id, []).append(raw)
        found = []
        for tag_id in sorted(accepted):
            if len(accepted[tag_id]) > 1:  # at most one can be right, and nothing says which
                rejected["rejected: id seen twice in a frame"] += len(accepted[tag_id])
                continue
            detection = self._detection(frame, origin, accepted[tag_id][0], rejected)
            if detection is not None:
                found.append(detection)
        if count:
            self.tally.update(rejected)
        return found

    def _detection(self, frame: Frame, origin: tuple[int, int], raw: Any, notes: Counter[str]) -> Detection | None:
        # the library counts pixels from the first one's corner, we from its middle
        corners = np.asarray(raw.corners, dtype=float) - 0.5 + np.asarray(origin, dtype=float)
        cov, refined = np.zeros((4, 2, 2)), False
        settings, cells = self.settings, FAMILIES[raw.tag_family.decode()]
        if settings.refine:
            corners, cov, refined = refine_corners(frame.image, self.camera, corners, cells=cells)
            notes["corners not refined"] += not refined
        sigma = UNREFINED_SIGMA
        if settings.refine:
            hidden, cell = hidden_edges(frame.image, np.ascontiguousarray(corners), cells)
            hidden_sigma = HIDDEN_SIGMA * cell
            sigma = max(sigma, hidden_sigma)  # where the edges fit no tag's, the image's border or a hand cuts it
            if hidden.any():  # what lies against one edge biases the fit of the other edges a little too
                share = np.where(hidden | np.roll(hidden, 1), 1.0, BESIDE_HIDDEN)
                cov = cov + (share * hidden_sigma)[:, None, None] ** 2 * np.eye(2)
                notes["edges that may not be the tag's"] += 1
        if not refined:
            if not self.camera.contains(corners, margin=BORDER).all():
                notes["rejected: cut by the image's edge"] += 1
                return None
            cov = np.tile(sigma**2 * np.eye(2), (4, 1, 1))
        return Detection(
            camera=frame.camera,
            t=frame.t,
            tag_id=int(raw.tag_id),
            corners=corners,
            corner_cov=cov,
            hamming=int(raw.hamming),
            margin=float(raw.decision_margin),
        )


class _QuadThreshold(ctypes.Structure):
    """The AprilTag library's `apriltag_quad_thresh_params` (apriltag.h), which the binding does not show."""

    _fields_ = (
        ("min_cluster_pixels", ctypes.c_int),
        ("max_nmaxima", ctypes.c_int),
        ("critical_rad", ctypes.c_float),
        ("cos_critical_rad", ctypes.c_float),
        ("max_line_fit_mse", ctypes.c_float),
        ("min_white_black_diff", ctypes.c_int),
        ("deglitch", ctypes.c_int),
    )

    def is_default(self) -> bool:
        """Whether these are what the library begins with; if not, its struct is laid out otherwise."""
        counts = (self.min_cluster_pixels, self.max_nmaxima, self.min_white_black_diff, self.deglitch)
        return counts == (5, 10, 5, 0) and self.max_line_fit_mse == 10.0


def _threshold(detector: Detector) -> _QuadThreshold:
    """The part of the library's detector that follows the last field that the binding shows."""
    shown = detector.tag_detector_ptr.contents
    after = type(shown).debug.offset + ctypes.sizeof(ctypes.c_int)
    return _QuadThreshold.from_address(ctypes.addressof(shown) + after)


class _Detector(Detector):
    """A detector of several families; the binding takes only the first of those it is given.

    It is never destroyed: the binding frees the tag family before the detector that still refers to it,
    which corrupts the heap.
    """

    def __init__(self, families: tuple[str, ...], decimate: float, min_margin: float) -> None:
        """Make the library's detector.

        Args:
            families: Names of the families.
            decimate: Reduction of the image.
            min_margin: Least decision margin of a tag that is wanted [grey levels].
        """
        super().__init__(families=families[0], nthreads=1, quad_decimate=decimate)
        for family in families[1:]:
            create = getattr(self.libc, f"{family}_create")
            create.restype = ctypes.c_void_p
            corrected_bits = 2 if family in FAMILIES else 0  # for some, the table of corrections takes a gigabyte
            made = ctypes.c_void_p(create())
            self.libc.apriltag_detector_add_family_bits(self.tag_detector_ptr, made, corrected_bits)
        # The library looks for tags where neighbouring tiles differ by 5 grey levels. An image's noise does too, and
        # then most of the time goes into what is none. Between black and white of a tag lies twice its margin.
        threshold = _threshold(self)
        if threshold.is_default():
            threshold.min_white_black_diff = max(threshold.min_white_black_diff, int(min_margin))

    def __del__(self) -> None:
        pass


_spare: dict[tuple[tuple[str, ...], float, float], list[_Detector]] = {}
_spare_lock = threading.Lock()


@contextlib.contextmanager
def tag_detector(families: tuple[str, ...], decimate: float, min_margin: float) -> Iterator[_Detector]:
    """The library's detector for one's own use; it is kept for the next, as one serves one thread at a time.

    Args:
        families: Names of the families that it looks for; of those in `FAMILIES` it corrects two bits.
        decimate: Reduction of the image.
        min_margin: Least decision margin of a tag that is wanted [grey levels].

    Yields:
        The detector.
    """
    key = families, decimate, min_margin
    with _spare_lock:
        waiting = _spare.setdefault(key, [])
        detector = waiting.pop() if waiting else None
    if detector is None:
        detector = _Detector(*key)
    try:
        yield detector
    finally:
        with _spare_lock:
            _spare[key].append(detector)


def detect_frames(
    recording: Recording,
    model: ObjectModel | None,
    *,
    settings: DetectSettings = DEFAULT,
    threads: int = 2,
    tally: Counter[str] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Iterator[Detection]:
    """The tags of an object in all frames of a recording.

    Args:
        recording: The recording.
        model: The object; tags that are not on it are rejected. None: all tags are taken.
        settings: How tags are looked for.
        threads: Images searched at the same time.
        tally: Filled with counts by reason.
        progress: Called with the number of frames done since the last call.

    Yields:
        Detections in order of time (between cameras: within a batch of frames), in
        memory that does not grow with the recording.

    Raises:
        FileError: a frame that is no image.
    """
    if threads < 1:
        raise InputError(f"threads is {threads}, expected at least 1")
    if model is not None and not model.tags:
        raise ObjectError(f"object '{model.name}' has no tags to look for")
    tally = Counter() if tally is None else tally
    batches = _batches(recording)
    pool = ThreadPoolExecutor(max_workers=threads, thread_name_prefix="detect")
    running: deque[list[Future[tuple[list[Detection], Counter[str], int]]]] = deque()

    def start() -> None:
        with contextlib.suppress(StopIteration):
            work = next(batches)
            running.append([pool.submit(_detect_batch, recording, files, model, settings) for files in work])

    try:
        start()
        while running:
            start()  # one batch ahead
            together: list[Detection] = []
            for future in running.popleft():
                found, counts, n_frames = future.result()
                together += found
                tally.update(counts)
                if progress is not None:
                    progress(n_frames)
            yield from sorted(together, key=lambda detection: detection.t)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _batches(recording: Recording) -> Iterator[list[Sequence[FrameFile]]]:
    """For each stretch of time, one run of frames a camera."""
    first = min(files[0].t_ns for files in recording.frames.values())
    last = max(files[-1].t_ns for files in recording.frames.values())
    span = BATCH * 1e9 / recording.rate_hz if np.isfinite(recording.rate_hz) else float("inf")
    at = dict.fromkeys(recording.frames, 0)
    until = first + span
    while any(at[name] < len(files) for name, files in recording.frames.items()):
        work = []
        for name, files in recording.frames.items():
            begin = at[name]
            while at[name] < len(files) and (files[at[name]].t_ns < until or until > last):
                at[name] += 1
            if at[name] > begin:
                work.append(files[begin : at[name]])
        until += span
        if work:
            yield work


def _detect_batch(
    recording: Recording, files: Sequence[FrameFile], model: ObjectModel | None, settings: DetectSettings
) -> tuple[list[Detection], Counter[str], int]:
    finder = TagFinder(recording.camera(files[0].camera), model, settings, layout=recording.layout)
    found, n_frames = [], 0
    for frame in recording.run(files):
        found += finder.find(frame)
        n_frames += 1
    if n_frames < len(files):
        finder.tally[DAMAGED] += len(files) - n_frames
    return found, finder.tally, len(files)

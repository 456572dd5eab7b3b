"""The noise floor: what the noise of the recorded poses alone leaves of whitened residuals, with no simulator in it.

Where the stated noise is right, whitened residuals of a right simulator have unit variance, whatever first states were.
Whether it is right shows in flight, without a simulator: there positions follow a parabola and rotations turn evenly,
so third differences of both are noise, with sqrt(20) times its standard deviation. Where they show more noise than is
stated, the floor is that much higher. Where they show less, it stays: errors that follow each other over frames, as a
tracker's do, are smaller in differences than they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.density import student_deviance
from tossid.diagnosis.likelihood.states import difference
from tossid.diagnosis.likelihood.windows import Windows
from tossid.robust import NORMAL_MAD
from tossid.rotations import quat_boxminus
from tossid.settings.diagnosis.likelihood import DensitySettings

Array = NDArray[np.float64]

OF_THIRD_DIFFERENCES = math.sqrt(20.0)
"""Standard deviation of a third difference of independent errors over theirs: 1, -3, 3, -1."""
ORDER = 3
"""Order of the differences."""
FEWEST = 30
"""Third differences from which noise is measured."""


@dataclass(frozen=True)
class MeasuredNoise:
    """The noise of the recorded poses as flight shows it, over the noise that the dataset states.

    Attributes:
        position: Of positions; None where flight is too short to show it.
        rotation: Of rotations, likewise.
        still: (K,) channels in which no pose differs from another, as those out of a plane; none if empty.
    """

    position: float | None
    rotation: float | None
    still: tuple[bool, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """gap.json's "noise"."""
        return {"position_over_stated": self.position, "rotation_over_stated": self.rotation}

    def factors(self, channels: int) -> Array:
        """(K,) standard deviations of whitened residuals that noise alone leaves in each channel, at least 1.

        Channels in which nothing was measured have none.

        Args:
            channels: K; joints' noise is taken as stated.
        """
        position, rotation = (1.0 if each is None else max(1.0, each) for each in (self.position, self.rotation))
        sizes = np.array([position] * 3 + [rotation] * 3 + [1.0] * (channels - 6))
        return np.where(self.still, 0.0, sizes) if self.still else sizes


@dataclass(frozen=True)
class Floor:
    """What noise alone leaves of each channel.

    Attributes:
        deviance: (K,) expected deviance.
        rms: Root mean square of whitened residuals.
        noise: The noise as it was measured.
    """

    deviance: Array
    rms: float
    noise: MeasuredNoise


def measure_noise(windows: Windows) -> MeasuredNoise:
    """The noise of recorded poses over the stated one, from third differences in free flight.

    Args:
        windows: Of all tosses; those of free flight are used.
    """
    position, rotation, still = [], [], still_channels(windows)
    for w in np.flatnonzero(windows.free):
        n = int(windows.steps[w])
        q, std = windows.y[w, :n], windows.y_noise[w, :n].mean(axis=0)
        if n <= ORDER:
            continue
        # differences of frames that follow each other
        there = np.lib.stride_tricks.sliding_window_view(windows.present[w, :n], ORDER + 1).all(axis=1)
        position.append((np.diff(q[:, :3], n=ORDER, axis=0) / std[:3])[there][:, ~still[:3]].ravel())
        turns = quat_boxminus(q[1:, 3:7], q[:-1, 3:7])
        rotation.append((np.diff(turns, n=ORDER - 1, axis=0) / std[3:6])[there][:, ~still[3:6]].ravel())
    return MeasuredNoise(_size(position), _size(rotation), tuple(map(bool, still)) if still.any() else ())


def still_channels(windows: Windows) -> NDArray[np.bool_]:
    """(K,) channels in which all poses are the same: there nothing was measured, as out of a plane.

    Args:
        windows: Of all tosses.
    """
    cut = windows.settings.windows
    least = np.array([cut.least_position_std] * 3 + [cut.least_rotation_std] * (windows.channels - 3))
    moved = np.abs(difference(windows.y, windows.q[:, None])).max((0, 1))
    moved[:3] = np.ptp(windows.y[..., :3], axis=(0, 1))
    return np.asarray(moved < 1e-3 * least)


def _size(values: list[Array]) -> float | None:
    """Robust size of normalised third differences, over what the stated noise gives."""
    all_values = np.concatenate(values) if values else np.zeros(0)
    if len(all_values) < FEWEST:
        return None
    return float(NORMAL_MAD * np.median(np.abs(all_values))) / OF_THIRD_DIFFERENCES


def noise_floor(windows: Windows) -> Floor:
    """What noise alone leaves of whitened residuals in windows.

    Args:
        windows: Of all tosses.
    """
    noise = measure_noise(windows)
    factors = noise.factors(windows.channels)
    expected = np.array([expected_deviance(each, windows.settings.density) for each in factors])
    rms = float(np.sqrt((factors**2).mean()))
    return Floor(expected, rms, noise)


def expected_deviance(std: float, density: DensitySettings = DensitySettings()) -> float:
    """Mean of Student's deviance of normal residuals, by Gauss-Hermite quadrature.

    Args:
        std: Their standard deviation.
        density: Student's degrees of freedom.
    """
    nodes, weights = np.polynomial.hermite_e.hermegauss(64)
    return float(weights @ student_deviance(std * nodes, density) / weights.sum())

"""A long recording as a pose track: tosses, and all that hands do to an object between them, with the truth.

Everything is drawn from one seed. Tosses, kicks and falls from an edge are MuJoCo's; a hand moves the object along
fifth-degree polynomials.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np

from tests.vision.tosses import SUBSTEPS, settled
from tossid.motion.segmentation import rest_frame
from tossid.objects import ObjectModel, corner_positions, to_mjcf
from tossid.rotations import quat_boxminus, quat_exp, quat_mul, quat_normalize, right_jacobian_inv
from tossid.types import PoseTrack

RATE = 148.0
DT = 1 / RATE
KINDS = {
    "toss": 10, "toss, lost from view": 1, "toss, taken up again": 1, "put down gently": 2, "put down on an edge": 1,
    "carried past the table": 2, "caught in the air": 2, "caught just above the table": 1, "held still in the air": 1,
    "kicked": 2, "turned about in the hand": 1, "out of sight": 1,
}  # fmt: skip
"""What happens, and how often beside the others."""
UP = np.array([0.0, 0.0, 1.0])


@dataclass
class Handled:
    """t (n,), q (n, nq), seen (n,) whether the frame has a pose. release, rest: frames at which the tosses that count
    begin and end. kinds: (first, last, what happened) of everything, in order."""

    q: np.ndarray
    seen: np.ndarray
    release: list[int] = field(default_factory=list)
    rest: list[int] = field(default_factory=list)
    kinds: list[tuple[int, int, str]] = field(default_factory=list)

    @property
    def t(self) -> np.ndarray:
        return np.asarray(3.0 + DT * np.arange(len(self.q)))

    def tracked(self, rng: np.random.Generator, *, sigma: float = 5e-5, turn: float = 5e-4) -> PoseTrack:
        """With a tracker's noise [m, rad], one frame in 2000 off by some millimetres, and what is not seen left out."""
        n = len(self.q)
        q = self.q.copy()
        q[:, :3] += sigma * rng.normal(size=(n, 3))
        glitch = rng.random(n) < 1 / 2000
        q[glitch, :3] += 0.003 * rng.normal(size=(glitch.sum(), 3))
        q[:, 3:7] = quat_mul(q[:, 3:7], quat_exp(turn * rng.normal(size=(n, 3))))
        q[:, 7:] += turn * rng.normal(size=(n, q.shape[1] - 7))
        nv = q.shape[1] - 1
        cov = np.tile(np.diag([sigma**2] * 3 + [turn**2] * (nv - 3)), (n, 1, 1))
        return PoseTrack("recording", self.t[self.seen], q[self.seen], cov[self.seen])


class Handling:
    """Makes recordings of one object. kinds: as `KINDS`. gravity: (3,) [m/s²] in the table's frame."""

    def __init__(
        self,
        model: ObjectModel,
        rng: np.random.Generator,
        *,
        kinds: dict[str, int] = KINDS,
        gravity: tuple[float, float, float] = (0.0, 0.0, -9.81),
    ) -> None:
        self.model, self.rng, self.kinds = model, rng, kinds
        self.scene = mujoco.MjModel.from_xml_string(to_mjcf(model, timestep=DT / SUBSTEPS))
        self.scene.opt.gravity[:] = gravity

    def recording(self, seconds: float) -> Handled:
        """Something new happens until the time is over [s]."""
        rng, names = self.rng, list(self.kinds)
        share = np.array(list(self.kinds.values())) / sum(self.kinds.values())
        q, _ = self.simulate(*self.release())
        self.pieces, self.seen = [q[-1:]], [np.ones(1, dtype=bool)]
        made = Handled(np.zeros(0), np.zeros(0))
        while (first := self.count()) < seconds * RATE:
            kind = str(rng.choice(names, p=share))
            self.lie(rng.uniform(0.2, 1.5))
            self.happen(kind, made)
            made.kinds.append((first, self.count() - 1, kind))
        self.lie(0.5)
        made.q, made.seen = np.concatenate(self.pieces), np.concatenate(self.seen)
        made.q[:, 3:7] /= np.linalg.norm(made.q[:, 3:7], axis=1, keepdims=True)
        # now and then a frame or two without a pose
        lost = np.flatnonzero(rng.random(len(made.q)) < 1 / 400)
        made.seen[lost] = False
        made.seen[np.minimum(lost[::2] + 1, len(made.q) - 1)] = False
        return made

    def happen(self, kind: str, made: Handled) -> None:
        """One thing, from where the object lies to where it lies again."""
        rng = self.rng
        if kind.startswith("toss"):
            q, v = self.release()
            self.hand(q, v, rng.uniform(5, 12) * UP + rng.uniform(-3, 3, 3) * [1, 1, 0], rng.uniform(0.35, 0.8))
            flown, speed = self.simulate(q, v)
            if kind == "toss, taken up again":
                moving = np.flatnonzero(np.linalg.norm(speed[:, :3], axis=1) > 0.3)
                cut = max(int(moving[-1] * rng.uniform(0.8, 1.0)), 8)
                self.add(flown[:cut])
                q, _ = self.release()
                self.hand(q, np.zeros(self.model.nv), 0 * UP, rng.uniform(0.35, 0.6), speed=speed[cut - 1])
                self.put()
                return
            first = self.count()
            end = max(rest_frame(flown), 1)
            self.add(flown)
            if kind == "toss":
                made.release.append(first)
                made.rest.append(first + end)
            else:
                gap = first + int(rng.uniform(0.4, 0.8) * end)
                self.hide(gap, gap + round(rng.uniform(0.08, 0.3) * RATE))
        elif kind == "put down gently":
            self.put()
        elif kind == "put down on an edge":
            angle, yaw = rng.uniform(0.3, 0.7), rng.uniform(0, 2 * np.pi)
            tilt = quat_mul([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)], quat_exp(np.array([angle, 0, 0])))
            q = self.upright()
            q[3:7] = tilt
            q[2] -= corner_positions(self.model, q)[:, 2].min() - 2e-4
            self.hand(q, np.zeros(self.model.nv), 0 * UP, rng.uniform(0.7, 1.2), low=True)
            self.add(self.simulate(q, np.zeros(self.model.nv))[0])
        elif kind == "carried past the table":
            for _ in range(2):
                q = self.upright()
                q[:3] = [*rng.uniform(0.7, 1.0, 2) * rng.choice([-1, 1], 2), rng.uniform(-0.3, 0.1)]
                self.hand(q, np.zeros(self.model.nv), 0 * UP, rng.uniform(0.7, 1.2), free=True)
            self.put(long=True)
        elif kind.startswith("caught"):
            q, v = self.release()
            self.hand(q, v, rng.uniform(5, 12) * UP, rng.uniform(0.4, 0.8))
            self.fall(q, v, 0.06 if kind == "caught in the air" else 0.032)
            self.put(speed=self.speed, long=True)
        elif kind == "held still in the air":
            q, _ = self.release()
            self.hand(q, np.zeros(self.model.nv), 0 * UP, rng.uniform(0.5, 0.8))
            self.lie(rng.uniform(0.3, 0.8))
            self.put()
        elif kind == "kicked":
            q, v, way = self.pieces[-1][-1], np.zeros(self.model.nv), rng.uniform(0, 2 * np.pi)
            v[:2] = rng.uniform(0.3, 0.9) * np.array([np.cos(way), np.sin(way)])
            self.add(self.simulate(q, v)[0])
        elif kind == "turned about in the hand":
            for _ in range(3):
                q, _ = self.release()
                self.hand(q, np.zeros(self.model.nv), 0 * UP, rng.uniform(0.5, 0.9))
            self.put()
        else:  # out of sight while it is carried
            first = self.count()
            self.put()
            self.hide(first + 20, self.count() - 20)

    # the pieces

    def count(self) -> int:
        return sum(len(piece) for piece in self.pieces)

    def add(self, q: np.ndarray) -> None:
        self.pieces.append(q)
        self.seen.append(np.ones(len(q), dtype=bool))

    def hide(self, first: int, last: int) -> None:
        seen = np.concatenate(self.seen)
        seen[first : min(last, len(seen))] = False
        self.seen = [seen]

    def lie(self, seconds: float) -> None:
        self.add(np.repeat(self.pieces[-1][-1:], round(seconds * RATE), axis=0))

    def release(self) -> tuple[np.ndarray, np.ndarray]:
        """A state in which a hand lets go, as `tosses.thrown` has it."""
        rng, model = self.rng, self.model
        q, v, way, speed = np.zeros(model.nq), np.zeros(model.nv), rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 1.5)
        forward = np.array([np.cos(way), np.sin(way)])
        q[:2], q[3:7] = -0.3 * speed * forward + rng.uniform(-0.1, 0.1, 2), quat_normalize(rng.normal(size=4))
        q[7:] = rng.uniform(-1.2, 1.2, model.n_joints)
        q[2] = rng.uniform(0.1, 0.35) - corner_positions(model, q)[:, 2].min()
        v[:3], v[3:6] = [*speed * forward, rng.uniform(-0.5, 0.8)], rng.uniform(-6, 6, 3)
        return q, v

    def upright(self) -> np.ndarray:
        """Flat on the table somewhere, turned by anything about the vertical."""
        rng, q = self.rng, np.zeros(self.model.nq)
        yaw = rng.uniform(0, 2 * np.pi)
        q[:2], q[3:7] = rng.uniform(-0.3, 0.3, 2), [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
        q[2] = -corner_positions(self.model, q)[:, 2].min()
        return q

    def put(self, *, speed: np.ndarray | None = None, long: bool = False) -> None:
        """A hand puts it down flat."""
        q = self.upright()
        duration = self.rng.uniform(0.9, 1.4) if long else self.rng.uniform(0.6, 1.2)
        self.hand(q, np.zeros(self.model.nv), 0 * UP, duration, speed=speed, low=True)
        self.add(q[None])

    def hand(
        self,
        q1: np.ndarray,
        v1: np.ndarray,
        a1: np.ndarray,
        seconds: float,
        *,
        speed: np.ndarray | None = None,
        low: bool = False,
        free: bool = False,
    ) -> None:
        """From the last configuration (at `speed`, else at rest) to q1, where it has velocity v1 and acceleration a1.

        low: it ends on the table. free: there is none below.
        """
        q0 = self.pieces[-1][-1]
        v0 = np.zeros(self.model.nv) if speed is None else speed
        n = max(round(max(seconds, float(np.linalg.norm(q1[:3] - q0[:3])) / 2.0) * RATE), 4)
        s, T = np.arange(1, n) / n, n * DT
        turn = quat_boxminus(q1[3:7], q0[3:7])
        p = q0[:3] + _quintic(s, q1[:3] - q0[:3], v0[:3] * T, v1[:3] * T, a1 * T**2)
        rate = right_jacobian_inv(turn) @ v1[3:6]
        angle = _quintic(s, turn, v0[3:6] * T, rate * T, np.zeros(3))
        joints = q0[7:] + _quintic(s, q1[7:] - q0[7:], v0[6:] * T, v1[6:] * T, np.zeros(self.model.n_joints))
        q = np.concatenate([p, quat_mul(q0[3:7], quat_exp(angle)), joints], axis=1)
        if not free:  # lifted off the table meanwhile
            clear = 0.02 * np.minimum(1, 6 * s) * (np.minimum(1, 6 * (1 - s)) if low else 1)
            under = corner_positions(self.model, q)[..., 2].min(axis=1) - clear
            bump = 64 * (s * (1 - s)) ** 3
            q[:, 2] += min(float(np.max(np.where(under < 0, -under, 0) / np.maximum(bump, 0.02))), 0.5) * bump
        self.add(q)

    def fall(self, q: np.ndarray, v: np.ndarray, height: float) -> None:
        """Free flight that ends in a hand, the lowest corner so high [m]."""
        flown, speed = self.simulate(q, v)
        low = corner_positions(self.model, flown)[..., 2].min(axis=1)
        last = max(int(np.argmax(low < height)), 4)
        self.add(flown[:last])
        # the hand gives way over some centimetres
        self.speed = 0.2 * speed[last - 1]
        n = 6
        s = np.arange(1, n + 1) / n
        q1 = flown[last - 1]
        slow = np.concatenate([[0.0], np.cumsum(1 - 0.8 * s)])[1:, None] * DT
        path = np.repeat(q1[None], n, axis=0)
        path[:, :3] += slow * speed[last - 1, :3] * 0.5
        path[:, 2] = np.maximum(path[:, 2], q1[2] - 0.6 * height)
        path[:, 3:7] = quat_mul(q1[3:7], quat_exp(slow * speed[last - 1, 3:6]))
        self.add(path)

    def simulate(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Left alone until it rests: q (n, nq), v (n, nv)."""
        return settled(self.scene, q, v)


def _quintic(s: np.ndarray, end: np.ndarray, v0: np.ndarray, v1: np.ndarray, a1: np.ndarray) -> np.ndarray:
    """Polynomial in s from 0 with velocity v0 and no acceleration to `end` with v1 and a1 at s = 1. (n, k)."""
    x, power = end - v0, s[:, None]
    v = v1 - v0
    c3, c4, c5 = 10 * x - 4 * v + 0.5 * a1, -15 * x + 7 * v - a1, 6 * x - 3 * v + 0.5 * a1
    return np.asarray(power * v0 + power**3 * (c3 + power * (c4 + power * c5)))

"""What a model can learn, each as a small torch module that maps free numbers to physical ones."""

from __future__ import annotations

from math import exp, log, sqrt
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from tossid.objects import GRAVITY, ObjectModel
from tossid.physics import N_WORLD, LearnedAcceleration, learned_accelerations, n_features

torch_double = torch.float64

Array = NDArray[np.float64]


class Geometry(nn.Module):
    """Corner positions [m], in the bodies' frames, as offsets in units of `UNIT` times the object's width.

    With this unit an offset weighs about as much in the implicit loss as friction's logarithm does; with offsets in
    widths, friction would hardly change before the fit ends.

    Args:
        model: The object whose corners are the start.
        learn: False keeps them fixed.
    """

    UNIT = 0.02

    def __init__(self, model: ObjectModel, *, learn: bool) -> None:
        super().__init__()
        self.start = torch.as_tensor(model.corner_pos)
        self.scale = self.UNIT * model.width
        self.offset = nn.Parameter(torch.zeros_like(self.start), requires_grad=learn)

    def forward(self) -> Tensor:
        """(n_c, 3) [m]."""
        return self.start + self.scale * self.offset

    def move(self, corners: Array) -> None:
        """Put the corners elsewhere; training goes on from there.

        Args:
            corners: (n_c, 3) [m].
        """
        with torch.no_grad():
            self.offset.copy_((torch.as_tensor(corners) - self.start) / self.scale)


class Friction(nn.Module):
    """One Coulomb coefficient, kept positive by its logarithm.

    Args:
        model: The object whose friction is the start; one that is learned starts at `LEAST_FRICTION` or above.
        learn: False keeps it fixed.
    """

    def __init__(self, model: ObjectModel, *, learn: bool) -> None:
        super().__init__()
        mu = max(model.friction, LEAST_FRICTION) if learn else model.friction
        self.log_mu = nn.Parameter(torch.tensor(mu, dtype=torch_double).log(), requires_grad=learn)

    def forward(self) -> Tensor:
        """() dimensionless."""
        return self.log_mu.exp()

    def move(self, mu: float) -> None:
        """Put friction elsewhere; training goes on from there.

        Args:
            mu: Above zero.
        """
        with torch.no_grad():
            self.log_mu.fill_(log(mu))


class ContactLaw(nn.Module):
    """Spring, damper and cohesion of a corner on the ground; learned from rollouts only.

    The law is in `physics.stepping`. Three numbers: the logarithms of the contact time t_c [ms] and of the
    damping ratio zeta, and the cohesion in tenths of the object's weight, which may be none. With the object's mass m,

        compliance = t_c² / m,   relaxation = zeta t_c:

    a corner that carries a quarter of the mass turns within about pi t_c / 2, critically damped at zeta = 1. The
    implicit loss is rigid, as its sources are, and knows none of this.

    Args:
        model: The object; what it states is kept unless `learn`.
        learn: True learns all three.
    """

    RIGID = (0.05, 0.02)
    """Contact time [ms] and damping of a contact that is rigid.

    Where contact is rigid (simulated tosses), a softer one would have its effect explained by a wrong inertia."""
    RIGID_UP_TO = 0.1
    """Contact time up to which contact is rigid [ms]: no time step resolves so stiff a spring, and the steps of rigid
    contact end at impacts, which those of a spring do not."""

    def __init__(self, model: ObjectModel, *, learn: bool) -> None:
        super().__init__()
        self.mass = float(model.mass.sum())
        self.given = (model.compliance, model.relaxation, model.cohesion)
        self.value = nn.Parameter(torch.tensor([log(0.5), log(0.5), COHESION], dtype=torch_double), requires_grad=learn)

    def forward(self) -> tuple[float, float, float]:
        """Compliance [m/N], relaxation [s], cohesion [N]."""
        if not self.value.requires_grad:
            return self.given
        time, damping, cohesion = self.value.detach().tolist()
        cohesion = 0.1 * self.mass * GRAVITY * min(max(cohesion, 0.0), 20.0)
        if time <= log(self.RIGID_UP_TO):
            return 0.0, 0.0, cohesion
        t_c = 1e-3 * exp(min(time, log(50.0)))
        zeta = exp(min(max(damping, log(0.02)), log(20.0)))
        return t_c**2 / self.mass, zeta * t_c, cohesion

    def soft_starts(self) -> list[Tensor]:
        """The present value, and values of contact that yields, from which a fit may start.

        The prediction error has ridges between little bounce and much. The rollouts' time step h damps by itself, so a
        relaxation r is taken as sqrt(r² + 2 h r). Cohesion is the present one, but at least that of every start.
        """
        pairs = [(time, damping * time) for time in CONTACT_TIMES_MS for damping in DAMPINGS]
        damped = [(time, sqrt(slow**2 + 2 * SIMULATOR_STEP_MS * slow)) for time, slow in pairs]
        cohesion = max(COHESION, float(self.value.detach()[2]))
        starts = [torch.tensor([log(time), log(slow / time), cohesion], dtype=torch_double) for time, slow in damped]
        return [start for start in (self.value.detach().clone(), *starts) if float(start[0]) > log(RIGID_TIME_MS)]

    @property
    def yields(self) -> bool:
        """Whether contact is softer than rollouts can tell from rigid contact."""
        return float(self.value.detach()[0]) > log(RIGID_TIME_MS)

    def move(self, value: Tensor) -> None:
        """Put the law elsewhere; training goes on from there.

        Args:
            value: (3,), of `soft_starts` or `rigid`.
        """
        with torch.no_grad():
            self.value.copy_(value)

    def rigid(self) -> Tensor:
        """The value of a rigid contact."""
        time, damping = self.RIGID
        return torch.tensor([log(time), log(damping), 0.0], dtype=torch_double)


class LearnedAccelerationNet(nn.Module):
    """A learned acceleration a_res(q, v): linear in the features plus a small network.

    `physics.LearnedAcceleration` has the formula; the force is k_res = M a_res. A uniform vertical acceleration, which
    is what a wrong gravity needs, is a parameter of its own: it may be large, while the linear part and the network,
    which start at zero, are penalised. It can be left out.

    With the features of the world there is an acceleration along the world's axes beside the one in the base's frame:
    a field. Its linear part is in 1, position and velocity, so that a uniform force, a spring, a vortex whose force
    grows with the distance, and a viscous drag are linear in it.

    Args:
        n_joints: Joints beside the free base.
        hidden: Width of the two hidden layers.
        generator: For the first weights.
        world: Position, heading and velocity in the world are inputs, too.
        gravity: There is a uniform vertical acceleration of its own.
    """

    def __init__(
        self, n_joints: int, *, hidden: int, generator: torch.Generator, world: bool = False, gravity: bool = True
    ) -> None:
        super().__init__()
        nf, nv = n_features(n_joints), 6 + n_joints
        self.n_joints, self.world, self.gravity = n_joints, world, gravity
        self.n_inputs = n_features(n_joints, world=world)

        def weights(rows: int, columns: int) -> nn.Parameter:
            values = torch.randn(rows, columns, generator=generator, dtype=torch_double)
            return nn.Parameter(values / columns**0.5)

        self.vertical = nn.Parameter(torch.zeros((), dtype=torch_double), requires_grad=gravity)
        self.linear = nn.Parameter(torch.zeros(nv, nf, dtype=torch_double))
        if world:
            self.linear_world = nn.Parameter(torch.zeros(3, N_WORLD - HEADING, dtype=torch_double))
        self.W0, self.b0 = weights(hidden, self.n_inputs), nn.Parameter(torch.zeros(hidden, dtype=torch_double))
        self.W1, self.b1 = weights(hidden, hidden), nn.Parameter(torch.zeros(hidden, dtype=torch_double))
        self.W2 = nn.Parameter(torch.zeros(nv + 3 if world else nv, hidden, dtype=torch_double))

    def forward(self, features: Tensor) -> Tensor:
        """The learned acceleration in the base's frame (N, nv) [m/s², rad/s²].

        Args:
            features: (N, n_f), of `physics.tree_batch`, with those of the world.
        """
        return self.with_vertical(self.without_vertical(features), features)

    def with_vertical(self, rest: Tensor, features: Tensor) -> Tensor:
        """The learned acceleration (N, nv), of what `without_vertical` gives.

        Args:
            rest: (N, nv).
            features: (N, n_f) with the features of the world.
        """
        vertical = SCALE * self.vertical * features[:, :3]
        return torch.cat([rest[:, :3] + vertical, rest[:, 3:]], dim=-1)

    def without_vertical(self, features: Tensor) -> Tensor:
        """The same without its uniform vertical part."""
        found: Tensor = learned_accelerations(self._numbers(vertical=False), features, len(self.linear), of=torch)
        return found

    def uniform_vertical(self) -> float:
        """The uniform vertical acceleration, up positive [m/s²], that of the linear part included."""
        with torch.no_grad():
            value: Tensor = self.vertical
            if self.world:
                value = value + self.linear_world[2, 0]
            elif not self.gravity:
                value = value + self.linear[:3, :3].trace() / 3
            return SCALE * float(value)

    def arrays(self) -> LearnedAcceleration:
        """The same function for the simulator's kernels."""
        with torch.no_grad():
            return LearnedAcceleration(*(part.numpy().copy() for part in self._numbers()))

    def _numbers(self, *, vertical: bool = True) -> Any:
        """The parts of a `LearnedAcceleration`, as tensors with gradients."""
        nv, nf = self.linear.shape
        linear = torch.zeros(len(self.W2), self.n_inputs, dtype=torch_double)
        linear[:nv, :nf] = SCALE * self.linear
        if self.world:
            linear[nv:, nf + HEADING :] = SCALE * self.linear_world
        if vertical:
            linear[:3, :3] += SCALE * self.vertical * torch.eye(3, dtype=torch_double)
        parts: Any = (linear, self.W0, self.b0, self.W1, self.b1, SCALE * self.W2)
        return LearnedAcceleration(*parts)


LEAST_FRICTION = 0.01
"""Where a learned friction starts if less is stated: no share of 0 is another friction."""

HEADING = 6
"""Features of the world before those that its linear part takes."""

COHESION = 0.03
"""Start of cohesion, in tenths of the object's weight."""
CONTACT_TIMES_MS, DAMPINGS = (0.5, 1.0, 2.0, 3.0, 5.0), (0.2, 0.4, 0.7, 1.5)
"""Contact times [ms] and damping ratios of the starts of a contact law; the real cube's are 2 to 3 ms and 0.5."""
SIMULATOR_STEP_MS = 1.7
"""Time step of rollouts of 148 Hz, three a frame [ms]; damping within one step is numerical."""
RIGID_TIME_MS = 0.6
"""Contact time up to which contact is rigid as far as such a step can resolve [ms]."""

SCALE = 10.0
"""Unit of the output of k_res [m/s², rad/s²], so that its weights are of order one."""

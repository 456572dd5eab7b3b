"""What a model can learn, each as a small torch module that maps free numbers to physical ones."""

from __future__ import annotations

from math import exp, log, sqrt

import numpy as np
import torch
from torch import Tensor, nn

from tossid.objects import GRAVITY, ObjectModel
from tossid.physics import Residual, n_features

torch_double = torch.float64


class Geometry(nn.Module):
    """Corner positions [m], in the bodies' frames, as offsets in units of `UNIT` times the object's width.

    The unit makes an offset weigh about as much in the implicit loss as friction's
    logarithm does; with offsets in widths, friction would hardly move before the fit is done.

    Args:
        model: the object whose corners are the start.
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


class Friction(nn.Module):
    """One Coulomb coefficient, kept positive by its logarithm."""

    def __init__(self, model: ObjectModel, *, learn: bool, start: float | None = None) -> None:
        super().__init__()
        mu = model.friction if start is None else start
        self.log_mu = nn.Parameter(torch.tensor(float(np.log(mu)), dtype=torch_double), requires_grad=learn)

    def forward(self) -> Tensor:
        """() dimensionless."""
        return self.log_mu.exp()


class ContactLaw(nn.Module):
    """Spring, damper and cohesion of a corner on the ground (`physics.stepping` has the law); from rollouts only.

    Three numbers of order one: the logarithms of the contact time t_c [ms], of the damping zeta, and of the
    cohesion in tenths of the object's weight. With the object's mass m, compliance = t_c² / m and
    relaxation = zeta t_c: a corner that carries a quarter of the mass turns within about pi t_c / 2, critically
    damped at zeta = 1. The implicit loss knows none of it: it is rigid, as its sources are.

    Args:
        model: the object; what it states is kept unless `learn`.
        learn: True starts from a contact that is all but rigid.
    """

    CONTACT_TIMES = (0.5, 1.0, 2.0, 3.0, 5.0)
    DAMPINGS = (0.2, 0.4, 0.7, 1.5)
    """Starts that a fit looks through: between hardly any bounce and much of it the loss has ridges."""
    STEP = 1.7
    """[ms] of rollouts: less damping than one step's is not told from none, and starts have more than that."""

    def __init__(self, model: ObjectModel, *, learn: bool) -> None:
        super().__init__()
        self.mass = float(model.mass.sum())
        self.given = (model.compliance, model.relaxation, model.cohesion)
        self.value = nn.Parameter(
            torch.tensor([log(0.5), log(0.5), log(COHESION)], dtype=torch_double), requires_grad=learn
        )

    def forward(self) -> tuple[float, float, float]:
        """Compliance [m/N], relaxation [s], cohesion [N]."""
        if not self.value.requires_grad:
            return self.given
        time, damping, cohesion = self.value.detach().tolist()
        t_c = 1e-3 * exp(min(max(time, log(0.05)), log(50.0)))
        zeta = exp(min(max(damping, log(0.02)), log(20.0)))
        return t_c**2 / self.mass, zeta * t_c, 0.1 * self.mass * GRAVITY * exp(min(cohesion, 3.0))

    def starts(self) -> list[Tensor]:
        """Values to start from, with the cohesion that there is."""
        cohesion = float(self.value[2].detach())
        pairs = [(time, damping * time) for time in self.CONTACT_TIMES for damping in self.DAMPINGS]
        seen = [(time, sqrt(slow**2 + 2 * self.STEP * slow)) for time, slow in pairs]
        return [torch.tensor([log(time), log(slow / time), cohesion], dtype=torch_double) for time, slow in seen]


class ResidualNet(nn.Module):
    """Residual acceleration a_res(q, v), in the base's frame: linear in the features plus a small network.

    See `physics.Residual` for the formula. A uniform vertical acceleration, which is what wrong gravity needs,
    is a number of its own: it may be large, while the rest (linear part and network, which start at zero) has to
    pay for what it says.

    Args:
        n_joints: joints beside the free base.
        hidden: width of the two hidden layers.
        generator: for the start of the weights.
    """

    def __init__(self, n_joints: int, *, hidden: int, generator: torch.Generator) -> None:
        super().__init__()
        nf, nv = n_features(n_joints), 6 + n_joints

        def weights(rows: int, columns: int) -> nn.Parameter:
            values = torch.randn(rows, columns, generator=generator, dtype=torch_double)
            return nn.Parameter(values / columns**0.5)

        self.vertical = nn.Parameter(torch.zeros((), dtype=torch_double))
        self.linear = nn.Parameter(torch.zeros(nv, nf, dtype=torch_double))
        self.W0, self.b0 = weights(hidden, nf), nn.Parameter(torch.zeros(hidden, dtype=torch_double))
        self.W1, self.b1 = weights(hidden, hidden), nn.Parameter(torch.zeros(hidden, dtype=torch_double))
        self.W2 = nn.Parameter(torch.zeros(nv, hidden, dtype=torch_double))

    def forward(self, features: Tensor) -> Tensor:
        """(N, n_f) -> (N, nv) in the base's frame [m/s², rad/s²]."""
        vertical = SCALE * self.vertical * features[:, :3]
        rest = self.rest(features)
        return torch.cat([rest[:, :3] + vertical, rest[:, 3:]], dim=-1)

    def rest(self, features: Tensor) -> Tensor:
        """The same without the uniform vertical acceleration."""
        hidden = torch.tanh(torch.tanh(features @ self.W0.T + self.b0) @ self.W1.T + self.b1)
        return SCALE * (features @ self.linear.T + hidden @ self.W2.T)

    def arrays(self) -> Residual:
        """The same function for the simulator's kernels."""
        n = lambda p: np.ascontiguousarray(p.detach().numpy())  # noqa: E731
        linear = SCALE * n(self.linear)
        linear[:3, :3] += SCALE * float(self.vertical.detach()) * np.eye(3)
        return Residual(linear, n(self.W0), n(self.b0), n(self.W1), n(self.b1), SCALE * n(self.W2))


COHESION = 0.03
"""Start of cohesion, in tenths of the object's weight."""

SCALE = 10.0
"""Unit of the residual's output [m/s², rad/s²], so that its weights are of order one."""

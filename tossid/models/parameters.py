"""What a model can learn, each as a small torch module that maps free numbers to physical ones."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from tossid.objects import ObjectModel
from tossid.physics import Residual, n_features

torch_double = torch.float64


class Geometry(nn.Module):
    """Corner positions [m], in the bodies' frames, as offsets in units of the object's width.

    Args:
        model: the object whose corners are the start.
        learn: False keeps them fixed.
    """

    def __init__(self, model: ObjectModel, *, learn: bool) -> None:
        super().__init__()
        self.start = torch.as_tensor(model.corner_pos)
        self.width = model.width
        self.offset = nn.Parameter(torch.zeros_like(self.start), requires_grad=learn)

    def forward(self) -> Tensor:
        """(n_c, 3) [m]."""
        return self.start + self.width * self.offset


class Friction(nn.Module):
    """One Coulomb coefficient, kept positive by its logarithm."""

    def __init__(self, model: ObjectModel, *, learn: bool, start: float | None = None) -> None:
        super().__init__()
        mu = model.friction if start is None else start
        self.log_mu = nn.Parameter(torch.tensor(float(np.log(mu)), dtype=torch_double), requires_grad=learn)

    def forward(self) -> Tensor:
        """() dimensionless."""
        return self.log_mu.exp()


class Restitution(nn.Module):
    """Newton's coefficient of restitution, held within [0, 0.95]; learned from rollouts only.

    The implicit loss has no bounce: it is inelastic, as its sources are.
    """

    def __init__(self, model: ObjectModel, *, learn: bool) -> None:
        super().__init__()
        self.value = nn.Parameter(torch.tensor(float(model.restitution), dtype=torch_double), requires_grad=learn)

    def forward(self) -> Tensor:
        """() dimensionless."""
        return self.value.clamp(0.0, 0.95)


class ResidualNet(nn.Module):
    """Residual acceleration a_res(q, v), in the base's frame: linear in the features plus a small network.

    See `physics.Residual` for the formula. The linear part holds what a wrong
    gravity, drag or spin coupling needs; the network starts at zero.

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

        self.linear = nn.Parameter(torch.zeros(nv, nf, dtype=torch_double))
        self.W0, self.b0 = weights(hidden, nf), nn.Parameter(torch.zeros(hidden, dtype=torch_double))
        self.W1, self.b1 = weights(hidden, hidden), nn.Parameter(torch.zeros(hidden, dtype=torch_double))
        self.W2 = nn.Parameter(torch.zeros(nv, hidden, dtype=torch_double))

    def forward(self, features: Tensor) -> Tensor:
        """(N, n_f) -> (N, nv) in the base's frame [m/s², rad/s²]."""
        hidden = torch.tanh(torch.tanh(features @ self.W0.T + self.b0) @ self.W1.T + self.b1)
        return SCALE * (features @ self.linear.T + hidden @ self.W2.T)

    def arrays(self) -> Residual:
        """The same function for the simulator's kernels."""
        n = lambda p: np.ascontiguousarray(p.detach().numpy())  # noqa: E731
        return Residual(SCALE * n(self.linear), n(self.W0), n(self.b0), n(self.W1), n(self.b1), SCALE * n(self.W2))


SCALE = 10.0
"""Unit of the residual's output [m/s², rad/s²], so that its weights are of order one."""

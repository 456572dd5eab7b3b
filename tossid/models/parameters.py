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


class Inertia(nn.Module):
    """Inertial parameters of every body by log-Cholesky factors of the pseudo-inertia.

    The pseudo-inertia S = [[Sigma, h], [h^T, m]] of a body is U U^T with
    U = exp(a) [[exp(d1), s12, s13, t1], [0, exp(d2), s23, t2], [0, 0, exp(d3), t3], [0, 0, 0, 1]]:
    every value is a physical body (Rucker and Wensing, "Smooth Parameterization of
    Rigid-Body Inertia", RA-L 2022). Tosses over the ground cannot see the scale of
    mass, so the base's mass (a) stays at what was given; t is the centre of mass.
    Lengths are in units of the object's width, so that all numbers are of order one.
    """

    def __init__(self, model: ObjectModel, *, learn: bool) -> None:
        super().__init__()
        w = model.width
        self.width = w
        S = np.zeros((model.n_bodies, 4, 4))
        for b in range(model.n_bodies):
            m, c = model.mass[b], model.com[b] / w
            at_origin = model.inertia[b] / w**2 + m * (c @ c * np.eye(3) - np.outer(c, c))
            S[b, :3, :3] = 0.5 * np.trace(at_origin) * np.eye(3) - at_origin
            S[b, :3, 3] = S[b, 3, :3] = m * c
            S[b, 3, 3] = m
        flip = S[:, ::-1, ::-1]
        U = np.linalg.cholesky(flip)[:, ::-1, ::-1]  # upper factor: U U^T = S
        a = np.log(U[:, 3, 3])
        U = U / U[:, 3, 3][:, None, None]

        def parameter(values: np.ndarray, *, free: bool = learn) -> nn.Parameter:
            return nn.Parameter(torch.as_tensor(values.copy()), requires_grad=free)

        self.log_scale = parameter(a, free=False)
        if model.n_bodies > 1:  # ratios of masses are visible: only the base's is fixed
            self.log_scale_links = parameter(a[1:])
        self.log_diagonal = parameter(np.log(np.stack([U[:, i, i] for i in range(3)], axis=-1)))
        self.shear = parameter(np.stack([U[:, 0, 1], U[:, 1, 2], U[:, 0, 2]], axis=-1))
        self.com = parameter(U[:, :3, 3])

    def forward(self) -> tuple[Tensor, Tensor, Tensor]:
        """mass (n_b,) [kg], first moment m c (n_b, 3) [kg m], inertia about the origin (n_b, 3, 3) [kg m²]."""
        e, s = self.log_diagonal.exp(), self.shear
        n = len(e)
        U = torch.zeros(n, 3, 3, dtype=torch_double)
        U[:, 0, 0], U[:, 1, 1], U[:, 2, 2] = e[:, 0], e[:, 1], e[:, 2]
        U[:, 0, 1], U[:, 1, 2], U[:, 0, 2] = s[:, 0], s[:, 1], s[:, 2]
        log_scale: Tensor = self.log_scale
        if n > 1:
            log_scale = torch.cat([log_scale[:1], self.log_scale_links])
        mass = (2 * log_scale).exp()
        sigma = mass[:, None, None] * (U @ U.mT + self.com[:, :, None] * self.com[:, None, :]) * self.width**2
        trace = sigma.diagonal(dim1=-2, dim2=-1).sum(-1)
        at_origin = trace[:, None, None] * torch.eye(3, dtype=torch_double) - sigma
        return mass, mass[:, None] * self.com * self.width, at_origin


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

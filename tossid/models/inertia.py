"""Inertial parameters of bodies as free numbers: three parameterisations behind one interface.

Each is a torch module whose `forward` gives mass (n_b,) [kg], first moment m c (n_b, 3) [kg m] and inertia about the
body's origin (n_b, 3, 3) [kg m²]. Tosses over a fixed ground do not determine the scale of mass: the base's mass is the
given one, and the ratios of the other bodies' masses to it are learned. Lengths are in units of the object's width and
masses in units of the body's given one, so that all numbers are of order one.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from tossid.errors import InputError
from tossid.objects import ObjectModel


class _Bodies(nn.Module):
    """Masses and centres of mass, which every parameterisation but log-Cholesky's holds as they are."""

    def __init__(self, model: ObjectModel, *, learn: bool) -> None:
        super().__init__()
        self.width = model.width
        self.given_mass = torch.as_tensor(model.mass.copy())
        self.com = _parameter(model.com / model.width, learn=learn)
        if model.n_bodies > 1:
            self.log_mass_links = _parameter(np.zeros(model.n_bodies - 1), learn=learn)

    def mass(self) -> Tensor:
        """(n_b,) [kg]."""
        if len(self.given_mass) == 1:
            return self.given_mass
        return self.given_mass * torch.cat([torch.zeros(1, dtype=torch.float64), self.log_mass_links]).exp()

    def about_origin(self, unit_inertia: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The interface's three values, from the inertia about the centre of mass over m w² (n_b, 3, 3)."""
        mass, c = self.mass(), self.com
        shift = (c * c).sum(-1)[:, None, None] * torch.eye(3, dtype=c.dtype) - c[:, :, None] * c[:, None, :]
        return mass, mass[:, None] * c * self.width, mass[:, None, None] * (unit_inertia + shift) * self.width**2


class LogCholesky(nn.Module):
    """Log-Cholesky factors of the pseudo-inertia: every value is a physical body.

    The pseudo-inertia S = [[Sigma, h], [h^T, m]] of a body is U U^T with
    U = exp(a) [[exp(d1), s12, s13, t1], [0, exp(d2), s23, t2], [0, 0, exp(d3), t3], [0, 0, 0, 1]]
    (Rucker and Wensing, "Smooth Parameterization of Rigid-Body Inertia", RA-L 2022);
    t is the centre of mass.
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
        self.log_scale = _parameter(a, learn=False)
        if model.n_bodies > 1:
            self.log_scale_links = _parameter(a[1:], learn=learn)
        self.log_diagonal = _parameter(np.log(np.stack([U[:, i, i] for i in range(3)], axis=-1)), learn=learn)
        self.shear = _parameter(np.stack([U[:, 0, 1], U[:, 1, 2], U[:, 0, 2]], axis=-1), learn=learn)
        self.com = _parameter(U[:, :3, 3], learn=learn)

    def forward(self) -> tuple[Tensor, Tensor, Tensor]:
        """Mass, first moment and inertia, as the module says."""
        e, s = self.log_diagonal.exp(), self.shear
        n = len(e)
        U = torch.zeros(n, 3, 3, dtype=torch.float64)
        U[:, 0, 0], U[:, 1, 1], U[:, 2, 2] = e[:, 0], e[:, 1], e[:, 2]
        U[:, 0, 1], U[:, 1, 2], U[:, 0, 2] = s[:, 0], s[:, 1], s[:, 2]
        log_scale: Tensor = self.log_scale
        if n > 1:
            log_scale = torch.cat([log_scale[:1], self.log_scale_links])
        mass = (2 * log_scale).exp()
        sigma = mass[:, None, None] * (U @ U.mT + self.com[:, :, None] * self.com[:, None, :]) * self.width**2
        trace = sigma.diagonal(dim1=-2, dim2=-1).sum(-1)
        at_origin = trace[:, None, None] * torch.eye(3, dtype=torch.float64) - sigma
        return mass, mass[:, None] * self.com * self.width, at_origin


class Triangular(_Bodies):
    """Inertia about the centre of mass as A^T A, A upper triangular; positive, but not always a body's.

    Nothing keeps the moments within the triangle inequality. A's six numbers are free.
    """

    def __init__(self, model: ObjectModel, *, learn: bool) -> None:
        super().__init__(model, learn=learn)
        unit = model.inertia / (model.mass[:, None, None] * model.width**2)
        self.A = _parameter(_six(np.linalg.cholesky(unit).transpose(0, 2, 1)), learn=learn)

    def forward(self) -> tuple[Tensor, Tensor, Tensor]:
        """Mass, first moment and inertia, as the module says."""
        A = torch.zeros(len(self.A), 3, 3, dtype=torch.float64)
        rows, columns = _SIX
        A[:, rows, columns] = self.A
        return self.about_origin(A.mT @ A)


class Direct(_Bodies):
    """Moments and products of inertia about the centre of mass, as they are, brought back to the nearest body.

    A body's second moments Sigma = tr(I)/2 1 - I are positive definite (the triangle
    inequality). Where the numbers leave that set, Sigma's eigenvalues are
    held at `SMALLEST` of their mean.
    """

    SMALLEST = 1e-3

    def __init__(self, model: ObjectModel, *, learn: bool) -> None:
        super().__init__(model, learn=learn)
        unit = model.inertia / (model.mass[:, None, None] * model.width**2)
        self.moments = _parameter(_six(unit), learn=learn)

    def forward(self) -> tuple[Tensor, Tensor, Tensor]:
        """Mass, first moment and inertia, as the module says."""
        I = torch.zeros(len(self.moments), 3, 3, dtype=torch.float64)
        rows, columns = _SIX
        I[:, rows, columns] = self.moments
        I[:, columns, rows] = self.moments
        return self.about_origin(torch.stack([self._physical(body) for body in I]))

    def _physical(self, I: Tensor) -> Tensor:
        eye = torch.eye(3, dtype=I.dtype)
        sigma = 0.5 * I.trace() * eye - I
        floor = self.SMALLEST * float(sigma.detach().trace().abs()) / 3
        with torch.no_grad():
            inside = bool(torch.linalg.eigvalsh(sigma)[0] >= floor)
        if inside:
            return I
        values, vectors = torch.linalg.eigh(sigma)
        sigma = vectors @ torch.diag(values.clamp(min=floor)) @ vectors.mT
        return sigma.trace() * eye - sigma


_SIX = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])
"""Rows and columns of the six numbers of an upper triangle."""


KINDS: dict[str, type[LogCholesky | Triangular | Direct]] = {
    "log_cholesky": LogCholesky,
    "triangular": Triangular,
    "direct": Direct,
}
"""The parameterisations by name."""


def make_inertia(model: ObjectModel, *, kind: str = "log_cholesky", learn: bool) -> LogCholesky | Triangular | Direct:
    """A parameterisation at the object's own inertia.

    Args:
        model: The object.
        kind: One of `KINDS`.
        learn: False keeps the numbers fixed.

    Raises:
        InputError: There is no such kind.
    """
    if kind not in KINDS:
        raise InputError(f"inertia '{kind}': expected one of {', '.join(KINDS)}")
    return KINDS[kind](model, learn=learn)


def divergence(learned: tuple[Tensor, Tensor, Tensor], given: tuple[Tensor, Tensor, Tensor]) -> Tensor:
    """How far bodies are from given ones: sum over bodies of tr(X) - log det X - 4, X = S_0^-1 S of pseudo-inertias.

    0 for equal bodies, without bound towards a massless or flat one: the entropic divergence of Lee, Wensing and Park,
    "Geometric robot dynamic identification", T-RO 2020.

    Args:
        learned: Mass (n_b,), first moment (n_b, 3), inertia about the origin (n_b, 3, 3).
        given: The same of the given bodies.
    """
    S, S_given = _pseudo(*learned), _pseudo(*given)
    root = torch.linalg.cholesky(S_given)
    shape = torch.linalg.solve_triangular(root, S, upper=False)
    X = torch.linalg.solve_triangular(root, shape.mT, upper=False)
    values = torch.linalg.eigvalsh(X).clamp(min=1e-9)  # defined for numbers of no physical body, too
    return (values - values.log() - 1).sum()


def _pseudo(mass: Tensor, moment: Tensor, inertia: Tensor) -> Tensor:
    """[[Sigma, h], [h^T, m]] of each body (n_b, 4, 4), Sigma = tr(I) / 2 - I."""
    trace = inertia.diagonal(dim1=-2, dim2=-1).sum(-1)
    sigma = 0.5 * trace[:, None, None] * torch.eye(3, dtype=inertia.dtype) - inertia
    top = torch.cat([sigma, moment[:, :, None]], dim=2)
    return torch.cat([top, torch.cat([moment, mass[:, None]], dim=1)[:, None, :]], dim=1)


def _six(matrices: np.ndarray) -> np.ndarray:
    return matrices[:, _SIX[0], _SIX[1]]


def _parameter(values: np.ndarray, *, learn: bool) -> nn.Parameter:
    return nn.Parameter(torch.as_tensor(np.array(values, dtype=float)), requires_grad=learn)

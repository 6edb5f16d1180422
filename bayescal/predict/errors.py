"""Validation errors: residuals of validation data, their predicted covariance, and which are gross."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from bayescal.estimate.outliers import rejected, scale
from bayescal.predict.distances import CentreDistances

USUAL = {"kind": 0.9, "target": 0.75}
"""Share of all measurements of a kind, and of a target, that gives the scale of their errors, if above 1.

Where more of them are off, they are not slips but model error. A fit uses the median instead: there, model
error inflates the noise that is estimated.
"""


@dataclass(frozen=True)
class Joint:
    """C measurements of one or more residuals each, under their predicted covariance."""

    rows: np.ndarray  # (C,) of the session, ascending
    first: np.ndarray  # (C,) index of the first residual of each
    size: np.ndarray  # (C,) number of residuals
    chi2: np.ndarray  # (C,)
    logdet: np.ndarray  # (C,) of the covariance, m2


@dataclass(frozen=True)
class ValidationErrors:
    """R residuals of validation contacts, three for a point, in the order of rows, and the distances."""

    how: str  # VALIDATED, LEFT_OUT or BLOCKED
    main: str  # noise group that the gap is compared with: "contact" where contacts are fitted, else "point"
    residual: np.ndarray  # (R,) m
    noise: np.ndarray  # (R,) m, of one residual, by the noise scale of the fit
    by_parameters: np.ndarray  # (R, F) m, by posterior standard normals; 0 where `noise` includes them
    rows: np.ndarray  # (R,) of the session
    kind: np.ndarray  # (R,) "planes" or "points"
    group: np.ndarray  # (R,) noise group: "contact" or "point"
    target: np.ndarray  # (R,) names
    block: np.ndarray  # (R,) labels for the bootstrap
    distances: CentreDistances
    own: np.ndarray | None = None  # (R, K) m2, `noise` of each with the K residuals of its row; None: alone
    dof: Mapping[str, float] = field(default_factory=dict)  # of the noise scale of each group; else known
    fold: np.ndarray | None = None  # (R,) block of a blocked cross-validation; None: one fit predicts all

    @property
    def sd(self) -> np.ndarray:
        """Predicted standard deviations (R,), m."""
        return np.sqrt(self.noise**2 + np.sum(self.by_parameters**2, axis=1))

    @property
    def joint(self) -> Joint:
        """The measurements: the residuals of one row together."""
        order = np.argsort(self.rows, kind="stable")
        rows, size = np.unique(self.rows, return_counts=True)
        start = np.cumsum(size) - size
        chi2, logdet = np.empty(len(rows)), np.empty(len(rows))
        for k in np.unique(size):
            mine = size == k
            at = order[start[mine][:, None] + np.arange(k)]
            by, r = self.by_parameters[at], self.residual[at]
            own = np.eye(k) * self.noise[at][..., None] ** 2 if self.own is None else self.own[at][..., :k]
            covariance = own + by @ np.swapaxes(by, 1, 2)
            chi2[mine] = np.sum(r * np.linalg.solve(covariance, r[..., None])[..., 0], axis=1)
            logdet[mine] = np.linalg.slogdet(covariance)[1]
        return Joint(rows, order[start], size, chi2, logdet)

    @property
    def gross(self) -> np.ndarray:
        """Which residuals (R,) belong to measurements that no calibration explains.

        By the rule for outliers of a fit (`estimate.outliers`), with the predicted covariance. Where the
        errors of many measurements are larger than predicted (`USUAL`), they are relative to these.
        """
        j = self.joint
        usual = np.ones(len(j.rows))
        for label, share in USUAL.items():
            of = getattr(self, label)[j.first]
            for own in np.unique(of):
                mine = of == own
                usual[mine] = np.maximum(usual[mine], scale(j.chi2[mine], j.size[mine], share=share))
        out, group = np.zeros(len(j.rows), bool), self.group[j.first]
        for name in np.unique(group):
            mine = group == name
            dof = self.dof.get(name, np.inf)
            out[mine] = rejected(j.chi2[mine], j.size[mine], usual[mine], dof)
        return np.isin(self.rows, j.rows[out])


def kept(*held: ValidationErrors) -> np.ndarray:
    """Which residuals (R,) of one session are used: all except those that are gross under every model."""
    return ~np.logical_and.reduce([h.gross for h in held])

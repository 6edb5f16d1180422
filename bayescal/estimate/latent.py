"""Joint readings as variables of the graph: every contact has its own reading errors.

The usual estimate adds the noise of the readings to the variance of a contact through the Jacobian.
Here each contact has n additional unknowns, its reading errors, and a separate factor. The two agree if
the model is linear within the noise of a reading.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from bayescal.arm.motion import Motion, Term
from bayescal.errors import BayescalError
from bayescal.estimate import Estimate, add_constraints, linearise
from bayescal.model import ARM, Block, Model

if TYPE_CHECKING:
    from factors.graph import Graph


def with_latent_readings(fitted: Estimate) -> Estimate:
    """Solve again with latent readings, from an estimate and with its noise scale and row weights.

    Raises
    ------
    BayescalError
        If the session states no noise of the readings.
    """
    from factors.graph import Graph

    model = fitted.model
    joint = model.scene.dataset.noise.joint
    if joint <= 0:
        raise BayescalError(
            "noise.joint_deg is 0: the readings have no errors to estimate",
            "--latent-joints",
            "state noise.joint_deg in dataset.yaml, or omit the option",
        )
    graph = Graph()
    slices = model.slices
    variables = [name for name, own in slices.items() if own.stop > own.start]
    for name in variables:
        graph.variable(name, slices[name].stop - slices[name].start)
    start = {name: fitted.z[slices[name]] for name in variables}
    n = model.scene.chain.n
    for block in model.blocks:
        scale = fitted.weights.scale[block.group]
        for k in np.flatnonzero(fitted.weights.row[block.name]):
            name = f"readings {block.rows[k]}"
            if name not in start:  # point and orientation of the same row share its readings
                graph.variable(name, n)
                start[name] = np.zeros(n)
            _add_contact(graph, model, block, int(k), name, scale, joint * scale)
    add_constraints(graph, model, variables)
    solution, iterations = graph.solve(start)
    z = np.concatenate([solution[name] for name in variables])
    covariance = graph.covariance(variables)
    linear = linearise(model, z, fitted.weights)
    return replace(
        fitted, z=z, covariance=covariance, linear=linear, iterations=fitted.iterations + iterations
    )


def _add_contact(
    graph: Graph, model: Model, block: Block, k: int, name: str, scale: float, joint: float
) -> None:
    """Add one contact; its residual is a function of arm, target and the contact's n reading errors."""
    size, n = len(model.parameters), model.scene.chain.n
    coupling = model.scene.dataset.robot.link_from_reading
    row = block.rows[[k]]
    terms = [(p, _at(term, k)) for p, term in block.motion.terms]
    terms += [
        (size + r, Term(j + 1, "rz", float(coupling[j, r])))
        for j in range(n)
        for r in range(n)
        if coupling[j, r]
    ]
    motion = Motion(model.scene.chain, model.scene.q[row], model.scene.tools[row], terms, size + n)
    own = replace(model.part(block, row), motion=motion)
    sigma = scale * float(block.sigma[k])

    def function(*parts: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        arm = parts[0] if size else np.zeros(0)
        target = parts[-2] if block.size else np.zeros(0)
        values = np.concatenate([model.deviations(arm), parts[-1] * joint])
        r, by_values, by_target = own.linearise(values, target)
        gradients = [by_values[:, :size] * model.sd / sigma] if size else []
        gradients += [by_target / sigma] if block.size else []
        return r / sigma, [*gradients, by_values[:, size:] * (joint / sigma)]

    names = ([ARM] if size else []) + ([block.target] if block.size else []) + [name]
    graph.factor(names, own.kind.rows, function)


def _at(term: Term, k: int) -> Term:
    return (
        term if np.ndim(term.driver) == 0 else Term(term.frame, term.axis, float(np.asarray(term.driver)[k]))
    )

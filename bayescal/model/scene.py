"""The scene: a dataset as geometry. Chain, angles, torques, nominal contacts, measurement kinds."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayescal.arm import chain as reference
from bayescal.arm.chain import Chain, chain_of, link_angles
from bayescal.arm.statics import Loads, Stance, gravity_loads, torques_on_links
from bayescal.dataset import Certificate, Dataset, Target
from bayescal.dataset.contacts import forms_of, load_centre, load_mass, measured_again
from bayescal.dataset.target_kinds import TargetKind, kinds_of, seen
from bayescal.effects import CertifiedValue, Circumstances, Face, Session
from bayescal.errors import BayescalError
from bayescal.model import block
from bayescal.model.parts import (
    STATED,
    as_seen,
    blur_of,
    bodies_of,
    once_for_rows,
    posed_rowwise,
    rowwise,
    sighted,
    u_of,
    unposed,
    views_of,
)
from bayescal.statistics import grouped
from factors.camera import Instrument, Orientation
from factors.certificate import RELATIONS, Shape, ordered, shape
from factors.contacts import Plane
from factors.kind import Kind


@dataclass(frozen=True)
class Scene:
    """A dataset, and the quantities that follow from it before a fit.

    `stance` is where the fitted arm stands relative to nominal, for the statics, and `compliances` are the
    fitted compliances by parameter (SI), through which added masses act.
    `oriented`: orientations that instruments read are used, in addition to the points.
    """

    dataset: Dataset
    stance: Stance | None = None
    oriented: bool = False
    compliances: Mapping[str, float] = field(default_factory=dict)
    origin: Scene | None = field(default=None, init=False, repr=False, compare=False)
    """The scene that was posed anew to give this one, if nominal angles do not depend on the pose."""
    parts: tuple[Scene, Scene] | None = field(default=None, init=False, repr=False, compare=False)
    """The scenes of the rows before and of the new ones, while it is measured: see `continued`."""

    def posed_at(self, stance: Stance, compliances: Mapping[str, float]) -> Scene:
        """Replace the stance and the compliances; both scenes share what is equal."""
        out = replace(self, stance=stance, compliances=compliances)
        if not self._sags:
            object.__setattr__(out, "origin", self.origin or self)
        return out

    @unposed
    def chain(self) -> Chain:
        """The nominal chain."""
        return chain_of(self.dataset.robot)

    @rowwise
    def tools(self) -> np.ndarray:
        """Nominal ball centre of each row in the flange frame, (N, 3), m."""
        centres = np.array([tool.centre for tool in self.dataset.tools])
        return centres[self.dataset.measurements.tool]

    @rowwise
    def _rigid_angles(self) -> np.ndarray:
        return link_angles(self.dataset.robot, self.dataset.measurements.readings)

    @posed_rowwise
    def loads(self) -> Loads | None:
        """Gravity moments about all hinges, N m, or None if the robot file states no masses."""
        robot = self.dataset.robot
        if robot.masses is None:
            return None
        gravity, mass, centre = self.dataset.gravity, load_mass(self.dataset), load_centre(self.dataset)
        return gravity_loads(robot, self.chain, self._rigid_angles, gravity, mass, centre, self.stance)

    @property
    def moments(self) -> np.ndarray | None:
        """Gravity moments (N, n + 1, 3) on frames 0 to n, N m, or None if the robot file states no masses."""
        return None if self.loads is None else self.loads.moments

    @rowwise
    def measured_torques(self) -> np.ndarray | None:
        """Torques (N, n), N m, on the links, if the session states that measured ones are used."""
        d = self.dataset
        if d.torques != "measured" or d.measurements.torque is None:
            return None
        return torques_on_links(d.robot, d.measurements.torque)

    @property
    def _sags(self) -> bool:
        """Whether the robot file states compliances: then the nominal angles depend on the pose."""
        compliance = self.dataset.robot.compliance
        return compliance is not None and bool(np.any(compliance))

    @rowwise
    def q(self) -> np.ndarray:
        """Nominal link angles (N, n), rad, with the deflection of compliances in the robot file."""
        if not self._sags:
            return self._rigid_angles
        torques = self.measured_torques
        if torques is None and self.loads is not None:
            torques = self.loads.torques(self.dataset.robot.slides)
        if torques is None:
            what = "joint_compliance_rad_per_nm without links"
            raise BayescalError(what, "robot file", "add masses under links")
        return self._rigid_angles + self.dataset.robot.compliance * torques

    @rowwise
    def points(self) -> np.ndarray:
        """Nominal ball centres (N, 3) in F0, m."""
        return reference.points(self.chain, self.q, self.tools)

    @rowwise
    def flange(self) -> np.ndarray:
        """Nominal orientations of the flange in F0, (N, 3, 3)."""
        return reference.frames(self.chain, self.q)[:, -1, :3, :3].copy()  # not all frames in memory

    @unposed
    def tool_frames(self) -> np.ndarray:
        """Nominal orientation of each row's tool on the flange, (N, 3, 3)."""
        return block.tool_frames(self.dataset, self.flange)[self.dataset.measurements.tool]

    @unposed
    def posed(self) -> np.ndarray:
        """Which rows have an orientation of the tool that is used, (N,)."""
        return block.posed(self.dataset) & self.oriented

    @unposed
    def poses(self) -> np.ndarray:
        """Nominal poses of each row's tool in F0, (N, 3, 4)."""
        return np.concatenate([self.flange @ self.tool_frames, self.points[..., None]], axis=2)

    @unposed
    def blur(self) -> np.ndarray:
        """Factor on the noise of each row of a blurred image, (N,)."""
        return blur_of(self.dataset)

    @unposed
    def turning(self) -> np.ndarray:
        """Which rows depend on how the tool stands on the flange, (N,)."""
        return self.posed | self.in_images

    @unposed
    def as_seen(self) -> Scene:
        """The scene whose cameras and boards are where the images tell: slopes of views are taken there."""
        dataset = as_seen(self.dataset)
        return self if dataset is self.dataset else replace(self, dataset=dataset)

    @unposed
    def sighted(self) -> np.ndarray:
        """Pose of the board in the camera by the image of each row, (N, 3, 4), or nan."""
        return sighted(self.dataset)

    @unposed
    def in_images(self) -> np.ndarray:
        """Which rows are corners in images, (N,)."""
        return np.array([kind.posed for kind in self.declared])[self.dataset.measurements.target]

    def nominal(self, target: int, rows: np.ndarray) -> np.ndarray:
        """What the kind of a target judges in some rows, nominal: points (3, C) or poses (3, 4, C)."""
        of = self.poses if self.declared[target].posed else self.points
        return np.moveaxis(of[rows], 0, -1)

    def looks(self, target: int, rows: np.ndarray) -> np.ndarray:
        """Derivatives (k, 3, C) of nominal residuals of some rows by a shift of the tool in F0."""
        kind = self.kind(target, rows)
        return kind.linearise(np.zeros(len(kind.sd)), self.nominal(target, rows))[1][:, :3]

    @unposed
    def declared(self) -> tuple[TargetKind, ...]:
        """The declared kind of every target."""
        return kinds_of(self.dataset)

    @unposed
    def index(self) -> Mapping[str, int]:
        """Place of every target in the session, by its name."""
        return {t.name: k for k, t in enumerate(self.dataset.targets)}

    def declared_of(self, name: str) -> TargetKind:
        """The declared kind of a target, by its name."""
        return self.declared[self.index[name]]

    def rows(self, *roles: str) -> np.ndarray:
        """Indices of the rows with one of the roles, in order."""
        return np.flatnonzero(np.isin(self.dataset.measurements.role, roles))

    def rows_of(self, target: int, rows: np.ndarray) -> np.ndarray:
        """Those of `rows` that measure a target."""
        return rows[self.dataset.measurements.target[rows] == target]

    @once_for_rows
    def circumstances(self, fitted: np.ndarray) -> Circumstances:
        """The circumstances of the effects, for a model fitted to some rows; default: calibrate."""
        d, m = self.dataset, self.dataset.measurements
        used = tuple(int(k) for k in np.unique(m.tool[fitted]))
        targets = [d.targets[k] for k in np.unique(m.target[fitted])]
        turned = tuple(int(k) for k in np.unique(m.tool[fitted[self.turning[fitted]]]))
        return Circumstances(
            robot=d.robot,
            chain=self.chain,
            q=self.q,
            loads=self.loads,
            tool=m.tool,
            tool_names=tuple(tool.name for tool in d.tools),
            tool_centres=np.array([tool.centre for tool in d.tools]),
            tool_u=tuple(tool.u for tool in d.tools),
            fitted_tools=used,
            predicted_tools=self.tools_predicted(fitted),
            fitted=fitted,
            tied_base=_tied(targets),
            tied_tool=any(d.tools[k].u is not None for k in used)
            or any(d.tools[k].u_angle is not None for k in turned),
            readings=m.readings,
            gravity=d.gravity,
            load_mass=load_mass(d),
            load_centre=load_centre(d),
            approach=self._approach,
            tool_radii=tuple(tool.ball_radius for tool in d.tools),
            velocity=m.velocity,
            command=m.command,
            repeat=m.repeat,
            speed=self._speed,
            time=m.time,
            temperature=None if d.temperature_of == "artefact" else m.temperature,
            faces=tuple(self._faces(fitted)),
            certified_values=tuple(self._certified_values({t.name for t in targets})),
            sessions=self._sessions(targets),
            **bodies_of(self, fitted),
            views=views_of(self, fitted),
            turned_tools=turned,
            tool_u_angle=tuple(tool.u_angle for tool in d.tools),
            stance=self.stance,
            compliances=self.compliances,
            measured_torques=self.measured_torques,
        )

    def tools_predicted(self, fitted: np.ndarray) -> tuple[int, ...]:
        """Tools of validation rows of fitted targets that no fitted row uses."""
        m = self.dataset.measurements
        mine = (m.role == "validate") & np.isin(m.target, m.target[fitted])
        return tuple(int(k) for k in np.setdiff1d(m.tool[mine], m.tool[fitted]))

    @rowwise
    def _inward(self) -> np.ndarray:
        """Inward normal of the nominal surface at each contact, (N, 3) in F0; nan if there is no surface."""
        target = self.dataset.measurements.target
        out = np.full((len(target), 3), np.nan)
        for t in np.unique(target):
            rows = np.flatnonzero(target == t)
            if self.declared[t].touched:
                out[rows] = -self.looks(int(t), rows)[0].T
        return out

    @rowwise
    def _approach(self) -> np.ndarray:
        """The inward normals in the flange frame, (N, 3)."""
        return (np.swapaxes(self.flange, -1, -2) @ self._inward[..., None])[..., 0]

    @rowwise
    def _speed(self) -> np.ndarray | None:
        """Speed of the nominal arm's ball along the inward normals, (N,), m/s; None without velocities."""
        velocity = self.dataset.measurements.velocity
        if velocity is None:
            return None
        still = np.zeros((len(self.q), self.chain.n + 2, 6))
        wrenches = reference.wrenches(self.chain, self.q, self.tools, still, self._inward)
        by = reference.by_joints(self.chain, wrenches) @ self.dataset.robot.link_from_reading
        return np.sum(by * velocity, axis=1)

    def _faces(self, fitted: np.ndarray) -> Iterator[Face]:
        d = self.dataset
        stated = {c.targets[0]: c.u_form for c in d.certificates if c.kind == "flat"}
        certified = {name for c in d.certificates for name in c.targets}
        for t in np.unique(d.measurements.target[fitted]):
            kind = self.kind(int(t), self.rows_of(int(t), fitted))
            if not self.declared[t].flat:
                continue
            assert isinstance(kind, Plane)
            touching = d.measurements.target == t
            place = np.where(touching[:, None], (self.points - kind.pivot) @ kind.tangents.T, 0.0)
            mine = place[self.rows_of(int(t), fitted)]
            low, high = mine.min(axis=0), mine.max(axis=0)
            place = (place - 0.5 * (low + high)) / np.maximum(0.5 * (high - low), 1e-6)
            # validation contacts slightly outside are evaluated at the edge: polynomials diverge beyond it
            place = np.where(touching[:, None], np.clip(place, -1.1, 1.1), 0.0)
            name = d.targets[t].name
            yield Face(name, touching.astype(float), place, stated.get(name), name in certified)

    def forms(self, entry: Certificate) -> tuple[str, str]:
        """Forms of both targets of a certificate, of `factors.certificate.FORMS`."""
        return forms_of([self.dataset.targets[self.index[name]] for name in entry.targets])

    def stated(self, entry: Certificate) -> tuple[tuple[str, str], ...]:
        """Values of a certificate, one residual each, and their units; () for a form error."""
        if entry.kind not in RELATIONS or entry.derived:
            return (("diameter", "m"),) if entry.kind == "diameter" else ()
        relations = RELATIONS[entry.kind][ordered(self.forms(entry))]
        return tuple(words for r in relations for words in STATED[entry.kind][r])

    def shape_of(self, entry: Certificate, fitted: Collection[str]) -> tuple[Shape, tuple[str, ...]] | None:
        """What certified coordinates state of fitted targets, and these; None where no placement has two."""
        points = entry.points
        assert points is not None
        used = [k for k, name in enumerate(entry.targets) if name in fitted]
        placed = grouped((points.placements[k], k) for k in used)
        groups = [group for group in placed.values() if len(group) > 1]
        names = tuple(entry.targets[k] for group in groups for k in group)
        if not names:
            return None
        index = iter(range(len(names)))
        places = [[(next(index), points.of[k]) for k in group] for group in groups]
        return shape(np.array(points.coordinates), np.array(points.covariance), places), names

    def _certified_values(self, fitted: set[str]) -> Iterator[CertifiedValue]:
        """All certified values of the targets with these names."""
        for numbers in measured_again(self.dataset.certificates, fitted):
            entry = self.dataset.certificates[numbers[0]]
            if entry.points is not None:
                yield from self._coordinates(entry, numbers, fitted)
                continue
            stated, of = self.stated(entry), entry.parts if len(numbers) > 1 else entry.targets
            for (what, unit), u, rows in zip(stated, u_of(entry, stated), np.eye(len(stated)), strict=True):
                yield CertifiedValue(f"{' '.join(of)} {what}", unit, float(u), numbers, rows)

    def _coordinates(
        self, entry: Certificate, numbers: tuple[int, ...], fitted: set[str]
    ) -> Iterator[CertifiedValue]:
        """The certified coordinates of the points that fitted targets are."""
        certified, points = self.shape_of(entry, fitted), entry.points
        if certified is None or points is None:
            return
        used = {points.of[entry.targets.index(name)] for name in certified[1]}
        u = np.sqrt(np.diag(points.covariance))
        for k in (3 * point + axis for point in sorted(used) for axis in range(3)):
            name = f"{points.names[k // 3]} {'xyz'[k % 3]}"
            if u[k] > 0:
                yield CertifiedValue(name, "m", float(u[k]), numbers, certified[0].by_coordinate[:, k])

    def _sessions(self, fitted: Sequence[Target]) -> tuple[Session, ...]:
        """The joined sessions, and whether a fitted target of each has a stated position."""
        of_row = np.array([t.session for t in self.dataset.targets])[self.dataset.measurements.target]
        return tuple(
            Session(s.name, of_row == s.name, _tied([t for t in fitted if t.session == s.name]))
            for s in self.dataset.sessions
        )

    def group(self, target: int) -> str:
        """Noise group of a target's residuals, with common noise and scale: contact, point, pixel."""
        group, of = self.declared[target].noise, self.dataset.targets[target].noise
        return f"{group} of {of}" if of else group

    def sigma(self, rows: np.ndarray) -> np.ndarray:
        """Stated standard uncertainty of one residual of each row, m, without that of the readings."""
        d, m = self.dataset, self.dataset.measurements
        of_kind = [getattr(d.noise, kind.noise) or kind.usual for kind in self.declared]
        stated = np.array(of_kind)[m.target[rows]]
        for t in np.unique(m.target[rows]).tolist():
            if self.declared[t].posed:
                mine = m.target[rows] == t
                stated[mine] *= self.kind(t, rows[mine]).scale * self.blur[rows[mine]]  # type: ignore[attr-defined]
        if m.u is not None:
            stated = np.where(np.isnan(m.u[rows]), stated, m.u[rows])
        return stated

    def orientation(self, target: int, rows: np.ndarray) -> Orientation:
        """Orientation readings of an instrument in some of its rows."""
        of, d = self.kind(target, rows), self.dataset
        assert isinstance(of, Instrument)
        return Orientation(of.frame, block.read(d, rows), of.sd)

    def kind(self, target: int, rows: np.ndarray) -> Kind:
        """The measurement kind of a target, for some of its rows.

        The pivot about which it tilts is computed from all fitted data of the target (from all its rows if
        none is fitted), so that the same state applies to every choice of rows.
        """
        m, item = self.dataset.measurements, self.dataset.targets[target]
        mine = np.flatnonzero(m.target == target)
        fitted = mine[m.role[mine] == "calibrate"]
        middle = self.points[fitted if len(fitted) else mine].mean(axis=0)
        pose = np.moveaxis(self.poses[rows], 0, -1) if self.declared[target].posed else None
        return self.declared[target].build(item, seen(self.dataset, target, rows, middle, pose))


def _tied(targets: Sequence[Target]) -> bool:
    """Whether a target's position in F0 is stated."""
    return any(t.u is not None or t.u_angle is not None for t in targets)

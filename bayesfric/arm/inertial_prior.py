"""The bodies of a URDF: what they ask of the joints, and how well that is known.

Rigid-body dynamics are iDynTree's. Its wheel takes 21 MB and NumPy; Pinocchio's, as fast and as
well kept, brings Boost, Assimp, coal and others, 380 MB in all.

The regressor is linear in ten inertial parameters a body (Atkeson, An and Hollerbach 1986): mass,
first moment and inertia about the frame of its link. So a Gaussian over these, the URDF its centre,
is one over the torque along any motion; and of that a few directions are all that one joint feels
on one motion: the principal ones, by a singular value decomposition.
"""

from __future__ import annotations

import math
import os
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from bayesfric.arm.arm_options import Payload, Uncertainty, Vector
from bayesfric.arm.inertia import OF_ONE as _OF_ONE
from bayesfric.arm.inertia import inertia_of, tensor
from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.safe_read import read_text
from bayesfric.estimates.information import long_run_variance
from bayesfric.mechanism.quantities import Motion
from bayesfric.recordings.arrays import Array

_LARGEST = 10_000_000
_MOTIONS: dict[str, Motion] = {"revolute": "rotary", "continuous": "rotary", "prismatic": "linear"}
# What iDynTree says on stderr where it reads on past what it should not.
_REFUSED = ("[ERROR]", "[WARNING] InertiaElement")


@dataclass(frozen=True)
class UrdfJoint:
    """A joint of the URDF that moves."""

    name: str
    motion: Motion
    range: float  # between its limits, rad or m; infinite without
    mimics: tuple[str, float, float] | None  # whose position, times what, plus what
    endless: bool = False  # whether it turns on and on
    limit: Mapping[str, str] = field(default_factory=dict)  # as it is written


@dataclass(frozen=True, eq=False)
class Doubt:
    """A Gaussian over inertial parameters: ``nominal + spread @ z``, ``z`` standard normal.

    ``causes`` name the components of ``z`` and say what one of each is, with its unit.
    """

    nominal: Array  # (10 n_links,)
    spread: Array  # (10 n_links, n_causes)
    causes: Sequence[tuple[str, float, str]]
    inside: Array  # (n_causes,) a z of which a payload is a body that can be
    payload: Array  # (10 n_links,) what of the nominal is bolted on, as the last causes are

    def columns(self, *, loaded: bool) -> Array:
        """Nominal and spread, ``(10 n_links, 1 + n_causes)``, with what is bolted on or without."""
        found = np.column_stack([self.nominal, self.spread])
        if not loaded:
            found[:, 0] -= self.payload
            found[:, -_OF_ONE:] = 0.0
        return found


class Bodies:
    """The bodies of a URDF, its root fixed.

    Parameters
    ----------
    path
        The URDF; meshes are not looked for.
    gravity
        In the frame of its root, m/s².

    Attributes
    ----------
    joints
        Those that move and mimic none, by name.
    links
        Names of the bodies.
    gravity
        As given.

    Raises
    ------
    BadInput
        If it is no URDF, no joint of it moves, or its links have no inertials.
    """

    def __init__(self, path: Path, gravity: Vector) -> None:
        every = _joints(path)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # as an error one of SWIG's ends Python
                import idyntree.bindings as idyntree
        except ImportError as error:
            mend = "pip install 'bayesfric[arm]'"
            raise BadInput(str(path), "is a URDF, whose torques iDynTree computes", mend) from error
        loader = idyntree.ModelLoader()
        if wrong := _said(lambda: loader.loadModelFromFile(str(path))):
            raise BadInput(str(path), f"is no URDF of an arm: {wrong}", "look with check_urdf")
        model = loader.model()
        self.path = path
        self.joints = {name: joint for name, joint in every.items() if joint.mimics is None}
        self.links = [model.getLinkName(k) for k in range(model.getNrOfLinks())]
        self.gravity, self._engine = gravity, idyntree.KinDynComputations()
        self._engine.loadRobotModel(model)
        self._idyntree, self._model = idyntree, model.copy()
        found = idyntree.VectorDynSize()
        model.getInertialParameters(found)
        self._nominal = found.toNumPy().reshape(-1, _OF_ONE).copy()
        if not self._nominal[:, 0].any():
            raise BadInput(str(path), "no link has an <inertial> with a mass", "give links theirs")
        self._out = idyntree.MatrixDynSize(6 + model.getNrOfDOFs(), self._nominal.size)
        # from joints that mimic none to all coordinates, and torques back
        order = list(self.joints)
        self._moves, self._plus = np.zeros((len(every), len(order))), np.zeros(len(every))
        for name, joint in every.items():
            at = model.getJoint(model.getJointIndex(name)).getDOFsOffset()
            of, times, self._plus[at] = joint.mimics or (name, 1.0, 0.0)
            if of not in order:
                raise BadInput(str(path), f"{name!r} mimics {of!r}", nearest(of, order))
            self._moves[at, order.index(of)] = times

    def doubt(self, told: Uncertainty, payload: Payload) -> Doubt:
        """Lay out what is known of the inertial parameters, with what is bolted on.

        Raises
        ------
        BadInput
            If there is no such link.
        """
        moved = self._moved_by()
        # of several that most joints move the last
        link = payload.link or self.links[int(np.flatnonzero(moved == moved.max())[-1])]
        if link not in self.links:
            raise BadInput("payload.link", f"no link is called {link!r}", nearest(link, self.links))
        spread, causes, inside = list[Array](), list[tuple[str, float, str]](), list[float]()

        def add(
            name: str, sd: float, unit: str, body: int | slice, of_one: Any, start: float = 0.0
        ) -> None:
            column = np.zeros_like(self._nominal)
            column[body] = sd * np.asarray(of_one)
            spread.append(column.ravel())
            causes.append((name, sd, unit))
            inside.append(start)

        add("all bodies", told.factor, "", slice(None), self._nominal)
        for k, name in enumerate(self.links):
            mass = self._nominal[k, 0]
            if mass and moved[k]:
                add(f"{name} by itself", told.factor, "", k, self._nominal[k])
                at = self._nominal[k, 1:4] / mass
                for axis, way in zip("xyz", np.eye(3), strict=True):
                    change = mass * _moved(at, way)
                    add(f"centre of {name}, {axis}", told.centre, "m", k, change)
        k, at = self.links.index(link), np.array(payload.centre)
        add(f"payload of {link}", payload.mass_sd, "kg", k, _point(at), 1.0)
        reach, name = payload.mass_sd * payload.centre_sd, "of the payload"
        for axis, way in zip("xyz", np.eye(3), strict=True):
            add(f"moment {name}, {axis}", reach, "kg m", k, _moved(at, way))
        for x, axes in enumerate(("xx", "xy", "xz", "yy", "yz", "zz")):
            moment = np.zeros(_OF_ONE)
            moment[4:] = inertia_of(tensor(np.eye(6)[x]))
            start = float(axes[0] == axes[1])
            size = reach * payload.centre_sd
            add(f"second moment {name}, {axes}", size, "kg m²", k, moment, start)
        bolted = np.zeros_like(self._nominal)
        bolted[k] = payload.mass * _point(at)
        return Doubt(
            (self._nominal + bolted).ravel(), np.stack(spread, axis=1), causes, np.array(inside),
            bolted.ravel(),
        )  # fmt: skip

    def torques(self, motion: Array, parameters: Array) -> Array:
        """Torques of the joints for inertial parameters, ``(n_joints, k, n)``, N m or N.

        Parameters
        ----------
        motion
            ``(3, n_joints, n)`` position, speed and acceleration of :attr:`joints`.
        parameters
            ``(n_joints, 10 n_links, k)``, a joint's own k columns.
        """
        out = np.empty((motion.shape[2], len(parameters), parameters.shape[2]))
        for i, regressor in enumerate(self._regressors(motion)):
            out[i] = np.einsum("jp,jpk->jk", regressor, parameters)
        return np.moveaxis(out, 0, 2)

    def dynamics(self, parameters: Array) -> Callable[[Array, Array], tuple[Array, Array]]:
        """Give what forward dynamics are made of, for inertial parameters ``(10 n_links,)``.

        Returns
        -------
        callable
            Of position and speed ``(n_joints,)`` of :attr:`joints`: mass matrix ``(n_joints,
            n_joints)``, and torque without acceleration ``(n_joints,)``.
        """
        vector, engine = self._idyntree.VectorDynSize, self._idyntree.KinDynComputations()
        self._model.updateInertialParameters(vector.FromPython(parameters))
        engine.loadRobotModel(self._model)  # which is a copy
        count = self._model.getNrOfDOFs()
        mass = self._idyntree.MatrixDynSize(6 + count, 6 + count)
        bias = self._idyntree.FreeFloatingGeneralizedTorques(self._model)
        base, still, gravity = np.eye(4), np.zeros(6), np.array(self.gravity)

        def asked(q: Array, qd: Array) -> tuple[Array, Array]:
            engine.setRobotState(
                base, self._moves @ q + self._plus, still, self._moves @ qd, gravity
            )
            engine.getFreeFloatingMassMatrix(mass)
            engine.generalizedBiasForces(bias)
            inertia = self._moves.T @ mass.toNumPy()[6:, 6:] @ self._moves
            return inertia, self._moves.T @ bias.jointTorques().toNumPy()

        return asked

    def _regressors(self, motion: Array) -> Iterator[Array]:
        """Give the regressor of every moment, ``(n_joints, 10 n_links)``."""
        base, still, gravity = np.eye(4), np.zeros(6), np.array(self.gravity)
        q, qd, qdd = (self._moves @ x for x in motion)
        q += self._plus[:, None]
        for i in range(q.shape[1]):
            self._engine.setRobotState(base, q[:, i], still, qd[:, i], gravity)
            self._engine.inverseDynamicsInertialParametersRegressor(still, qdd[:, i], self._out)
            yield self._moves.T @ self._out.toNumPy()[6:]

    def _moved_by(self) -> NDArray[np.int64]:
        """Count the joints that feel each link."""
        somewhere = np.ones((3, len(self.joints), 1))
        felt = next(self._regressors(somewhere)).reshape(len(self.joints), -1, _OF_ONE)
        return np.asarray(np.count_nonzero(np.abs(felt).sum(axis=2) > 1e-9, axis=0))


def directions(columns: Array, small: float) -> Array:
    """Find combinations of causes that a joint's torque feels, ``(n_causes, k)``.

    They are orthonormal, so that their coefficients are standard normal, too. Of what is left out
    the torque's rms is less than ``small``. ``columns`` ``(n_causes, n)`` are the torques of one
    standard deviation of each cause.
    """
    left, size, _ = np.linalg.svd(columns / np.sqrt(columns.shape[1]), full_matrices=False)
    beyond = np.sqrt(np.cumsum(size[::-1] ** 2)[::-1])
    return np.asarray(left[:, beyond > max(small, 1e-6 * beyond[0])])


def resolution(torque: Array, speed: Array, acceleration: Array, columns: Array) -> float:
    """Say how small a torque, rms, a joint's log tells: the standard error of a mean.

    It is that of the residual, autocorrelated as it is (Andrews 1991), of least squares on
    ``columns`` ``(k, n)``, the bodies' torque first, and on friction.
    """
    sign = np.sign(speed)
    losses = [sign, speed, np.abs(columns[0]) * sign, acceleration, np.ones_like(speed)]
    x = np.stack([*columns, *losses], axis=1)
    left = torque - x @ np.linalg.lstsq(x, torque, rcond=None)[0]
    return float(math.sqrt(long_run_variance(left, np.arange(left.size))) / left.size)


def _point(at: Array) -> Array:
    """Inertial parameters of a kilogram at a place of the link's frame."""
    return np.array([1.0, *at, *inertia_of(np.outer(at, at))])


def _moved(at: Array, way: Array) -> Array:
    """Change of inertial parameters a kilogram as a body's centre moves from ``at``, per m."""
    return np.array([0.0, *way, *inertia_of(np.outer(at, way) + np.outer(way, at))])


def urdf_text(path: Path) -> str:
    """Read the text of a URDF; ``BadInput`` if it cannot be read."""
    return read_text(path, "name the robot's .urdf file", largest=_LARGEST)


def parsed_urdf(
    path: Path, text: str, parser: ElementTree.XMLParser | None = None
) -> ElementTree.Element:
    """Parse the text of a URDF; ``BadInput`` if it is no XML."""
    try:
        return ElementTree.fromstring(text, parser)
    except ElementTree.ParseError as error:
        raise _no_urdf(path, error) from None


def _no_urdf(path: Path, error: Exception) -> BadInput:
    return BadInput(str(path), f"is no URDF ({error})", "give what xacro makes")


def _joints(path: Path) -> dict[str, UrdfJoint]:
    """Read what iDynTree does not tell of the joints that move."""
    found = {}
    for joint in parsed_urdf(path, urdf_text(path)).findall("joint"):
        name, kind = joint.get("name", ""), joint.get("type", "")
        limit, mimic = (getattr(joint.find(one), "attrib", {}) for one in ("limit", "mimic"))
        if kind not in _MOTIONS:
            continue
        try:
            width = float(limit.get("upper", 0)) - float(limit.get("lower", 0))
            times, plus = float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0))
        except ValueError as error:
            raise _no_urdf(path, error) from None
        found[name] = UrdfJoint(
            name,
            _MOTIONS[kind],
            width if width > 0.0 and kind != "continuous" else np.inf,
            (mimic.get("joint", ""), times, plus) if mimic else None,
            kind == "continuous",
            limit,
        )
    if not found:
        raise BadInput(str(path), "has no joint that moves", "give the URDF of an arm")
    return found


def _said(load: Any) -> str:
    """Load something, and give the first complaint on stderr, where libraries in C++ write."""
    with tempfile.TemporaryFile() as caught:
        kept = os.dup(2)
        os.dup2(caught.fileno(), 2)
        try:
            load()
        finally:
            os.dup2(kept, 2)
            os.close(kept)
        caught.seek(0)
        lines = caught.read().decode("utf-8", "replace").splitlines()
    wrong = next((line for line in lines if line.startswith(_REFUSED)), "")
    return wrong.rpartition(" : ")[2].strip()

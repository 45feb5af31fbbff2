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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from bayesfric.arm.arm_options import Payload, Uncertainty, Vector
from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.opened import read_text
from bayesfric.estimates.information import long_run_variance
from bayesfric.mechanism.quantities import Motion
from bayesfric.recordings.arrays import Array

_LARGEST = 10_000_000
_MOTIONS: dict[str, Motion] = {"revolute": "rotary", "continuous": "rotary", "prismatic": "linear"}
_OF_ONE = 10  # inertial parameters of a body
# What iDynTree says on stderr where it reads on past what it should not.
_REFUSED = ("[ERROR]", "[WARNING] InertiaElement")


@dataclass(frozen=True)
class UrdfJoint:
    """A joint of the URDF that moves."""

    name: str
    motion: Motion
    range: float  # between its limits, rad or m; infinite without
    mimics: tuple[str, float, float] | None  # whose position, times what, plus what


@dataclass(frozen=True, eq=False)
class Doubt:
    """A Gaussian over inertial parameters: ``nominal + spread @ z``, ``z`` standard normal.

    ``causes`` name the components of ``z`` and say what one of each is, with its unit.
    """

    nominal: Array  # (10 n_links,)
    spread: Array  # (10 n_links, n_causes)
    causes: Sequence[tuple[str, float, str]]


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
        self._gravity, self._engine = np.array(gravity), idyntree.KinDynComputations()
        self._engine.loadRobotModel(model)
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
        link = payload.link or self._tip()
        if link not in self.links:
            raise BadInput("payload.link", f"no link is called {link!r}", nearest(link, self.links))
        spread, causes = list[Array](), list[tuple[str, float, str]]()

        def add(name: str, sd: float, unit: str, body: int | slice, of_one: Any) -> None:
            column = np.zeros_like(self._nominal)
            column[body] = sd * np.asarray(of_one)
            spread.append(column.ravel())
            causes.append((name, sd, unit))

        add("all bodies", told.factor, "", slice(None), self._nominal)
        first = np.eye(_OF_ONE)[1:4]  # moments along the axes
        for k, name in enumerate(self.links):
            if mass := self._nominal[k, 0]:
                add(f"{name} by itself", told.factor, "", k, self._nominal[k])
                for axis, moment in zip("xyz", mass * first, strict=True):
                    add(f"centre of {name}, {axis}", told.centre, "m", k, moment)
        k, one_kg = self.links.index(link), _point(np.array(payload.centre))
        add(f"payload of {link}", payload.mass_sd, "kg", k, one_kg)
        for axis, moment in zip("xyz", first, strict=True):
            name = f"moment of the payload, {axis}"
            add(name, payload.mass_sd * payload.centre_sd, "kg m", k, moment)
        nominal = self._nominal.copy()
        nominal[k] += payload.mass * one_kg
        return Doubt(nominal.ravel(), np.stack(spread, axis=1), causes)

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

    def _regressors(self, motion: Array) -> Iterator[Array]:
        """Give the regressor of every moment, ``(n_joints, 10 n_links)``."""
        base, still = np.eye(4), np.zeros(6)
        q, qd, qdd = (self._moves @ x for x in motion)
        q += self._plus[:, None]
        for i in range(q.shape[1]):
            self._engine.setRobotState(base, q[:, i], still, qd[:, i], self._gravity)
            self._engine.inverseDynamicsInertialParametersRegressor(still, qdd[:, i], self._out)
            yield self._moves.T @ self._out.toNumPy()[6:]

    def _tip(self) -> str:
        """Name the link that most joints move, of several the last."""
        somewhere = np.ones((3, len(self.joints), 1))
        moved = next(self._regressors(somewhere)).reshape(len(self.joints), -1, _OF_ONE)
        counts = np.count_nonzero(np.abs(moved).sum(axis=2) > 1e-9, axis=0)
        last = int(np.flatnonzero(counts == counts.max())[-1])
        return str(self.links[last])


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
    inertia = at @ at * np.eye(3) - np.outer(at, at)
    return np.array([1.0, *at, *inertia[np.triu_indices(3)]])


def _joints(path: Path) -> dict[str, UrdfJoint]:
    """Read what iDynTree does not tell of the joints that move."""
    text = read_text(path, "name the robot's .urdf file", largest=_LARGEST)
    found = {}
    try:
        for joint in ElementTree.fromstring(text).findall("joint"):
            name, kind = joint.get("name", ""), joint.get("type", "")
            limit, mimic = (getattr(joint.find(one), "attrib", {}) for one in ("limit", "mimic"))
            width = float(limit.get("upper", 0)) - float(limit.get("lower", 0))
            if kind in _MOTIONS:
                times, plus = float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0))
                found[name] = UrdfJoint(
                    name,
                    _MOTIONS[kind],
                    width if width > 0.0 and kind != "continuous" else np.inf,
                    (mimic.get("joint", ""), times, plus) if mimic else None,
                )
    except (ElementTree.ParseError, ValueError) as error:
        raise BadInput(str(path), f"is no URDF ({error})", "give what xacro makes") from None
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

"""The bodies of a URDF: what they ask of the joints, and how well that is known.

Rigid-body dynamics are iDynTree's. Its wheel takes 21 MB and NumPy; Pinocchio's, as fast and as
well kept, brings Boost, Assimp, coal and others, 380 MB in all.

The regressor is linear in ten inertial parameters a body (Atkeson, An and Hollerbach 1986): mass,
first moment and inertia about the frame of its link. So a Gaussian over these, the URDF its centre,
is one over the torque along any motion; and of that a few directions are all that one joint feels
on one motion: the principal ones, by a singular value decomposition.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from bayesfric.arm.arm_options import Payload, Uncertainty, Vector
from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.opened import read_text
from bayesfric.mechanism.quantities import Motion
from bayesfric.recordings.arrays import Array

_LARGEST = 10_000_000
_MOTIONS: dict[str, Motion] = {"revolute": "rotary", "continuous": "rotary", "prismatic": "linear"}
_OF_ONE = 10  # inertial parameters of a body


@dataclass(frozen=True)
class UrdfJoint:
    """A joint of the URDF that moves."""

    name: str
    motion: Motion
    child: str  # link
    limits: tuple[float, float]  # rad or m
    mimics: tuple[str, float, float] | None  # whose position, times what, plus what


@dataclass(frozen=True, eq=False)
class Motions:
    """Motion of joints at n moments, ``(n_joints, n)`` each; rad or m and s."""

    q: Array
    qd: Array
    qdd: Array

    def thinned(self, most: int) -> Motions:
        """Keep at most so many moments, evenly spread."""
        at = np.unique(np.linspace(0, self.q.shape[1] - 1, most).astype(int))
        return Motions(self.q[:, at], self.qd[:, at], self.qdd[:, at])


@dataclass(frozen=True, eq=False)
class Doubt:
    """A Gaussian over the inertial parameters: ``nominal + spread @ z``, ``z`` standard normal.

    ``causes`` name the components of ``z`` and what one of each is, with its unit.
    """

    nominal: Array  # (10 n_links,)
    spread: Array  # (10 n_links, n_causes)
    causes: tuple[tuple[str, float, str], ...]


class Bodies:
    """The bodies of a URDF, its root fixed.

    Parameters
    ----------
    path
        The URDF; meshes are not looked for.
    gravity
        In the frame of its root, m/s².

    Raises
    ------
    BadInput
        If it is no URDF, no joint of it moves, or its links have no inertials.
    """

    def __init__(self, path: Path, gravity: Vector) -> None:
        every, self._tip = _joints(path)
        try:
            import idyntree.bindings as idyntree
        except ImportError as error:
            mend = "pip install 'bayesfric[arm]'"
            raise BadInput(str(path), "is a URDF, whose torques iDynTree computes", mend) from error
        loader = idyntree.ModelLoader()
        if not loader.loadModelFromFile(str(path)):
            what = "is no URDF that iDynTree reads"
            raise BadInput(str(path), what, "look at it with check_urdf")
        model = loader.model()
        self.path = path
        self.joints = {name: joint for name, joint in every.items() if joint.mimics is None}
        self.links = tuple(model.getLinkName(k) for k in range(model.getNrOfLinks()))
        self._gravity, self._engine = np.array(gravity), idyntree.KinDynComputations()
        self._engine.loadRobotModel(model)
        found = idyntree.VectorDynSize()
        model.getInertialParameters(found)
        self._nominal = found.toNumPy().reshape(-1, _OF_ONE).copy()
        if not self._nominal[:, 0].any():
            raise BadInput(str(path), "no link has an <inertial> with a mass", "give links theirs")
        self._out = idyntree.MatrixDynSize(6 + model.getNrOfDOFs(), self._nominal.size)
        at = {name: model.getJoint(model.getJointIndex(name)).getDOFsOffset() for name in every}
        # from the joints that mimic none to all coordinates, and their torques back
        self._moves, self._plus = np.zeros((len(at), len(self.joints))), np.zeros(len(at))
        order = list(self.joints)
        for name, joint in every.items():
            of, times, self._plus[at[name]] = joint.mimics or (name, 1.0, 0.0)
            self._moves[at[name], order.index(of)] = times

    def doubt(self, told: Uncertainty, payload: Payload) -> Doubt:
        """Lay out what is known of the inertial parameters, with what is bolted on.

        Raises
        ------
        BadInput
            If there is no such link.
        """
        link = payload.link or self._tip
        if link not in self.links:
            raise BadInput("payload.link", f"no link is called {link!r}", nearest(link, self.links))
        bolted = _point(payload.mass, np.array(payload.centre))
        columns = [self._whole(range(len(self.links)), told.factor)]
        causes = [("all bodies", told.factor, "")]
        for k, name in enumerate(self.links):
            if mass := self._nominal[k, 0]:
                columns.append(self._whole([k], told.factor))
                causes.append((f"{name} by itself", told.factor, ""))
                for axis in range(3):
                    columns.append(self._one(k, 1 + axis, mass * told.centre))
                    causes.append((f"centre of {name}, {'xyz'[axis]}", told.centre, "m"))
        k = self.links.index(link)
        column = np.zeros_like(self._nominal)
        column[k] = _point(payload.mass_sd, np.array(payload.centre))
        columns.append(column)
        causes.append((f"payload of {link}", payload.mass_sd, "kg"))
        moment = payload.mass_sd * payload.centre_sd
        for axis in range(3):
            columns.append(self._one(k, 1 + axis, moment))
            causes.append((f"payload's moment, {'xyz'[axis]}", moment, "kg m"))
        nominal = self._nominal.copy()
        nominal[k] += bolted
        spread = np.stack([column.ravel() for column in columns], axis=1)
        return Doubt(nominal.ravel(), spread, tuple(causes))

    def torques(self, motion: Motions, parameters: Array) -> Array:
        """Torques of the joints for inertial parameters, ``(n_joints, k, n)``, N m or N.

        Parameters
        ----------
        motion
            Of :attr:`joints`, in their order.
        parameters
            ``(n_joints, 10 n_links, k)``, a joint's own k columns.
        """
        n_joints, _, k = parameters.shape
        out = np.empty((motion.q.shape[1], n_joints, k))
        for i, regressor in enumerate(self._regressors(motion)):
            out[i] = np.einsum("jp,jpk->jk", regressor, parameters)
        return np.moveaxis(out, 0, 2)

    def directions(self, motion: Motions, doubt: Doubt, small: Array) -> list[Array]:
        """Find combinations of the causes that each joint's torque feels, ``(n_causes, k)`` each.

        They are orthonormal, so that their coefficients are standard normal, too. Of what is left
        out the torque's rms is less than ``small`` ``(n_joints,)``, N m or N.
        """
        rows = np.stack([regressor @ doubt.spread for regressor in self._regressors(motion)])
        found = []
        for j, least in enumerate(small):
            _, size, right = np.linalg.svd(rows[:, j] / np.sqrt(len(rows)), full_matrices=False)
            left_out = np.sqrt(np.cumsum(size[::-1] ** 2)[::-1])
            found.append(right[left_out > least].T)
        return found

    def _regressors(self, motion: Motions) -> Iterator[Array]:
        """Give the regressor of every moment, ``(n_joints, 10 n_links)``."""
        base, still = np.eye(4), np.zeros(6)
        q, qd, qdd = (self._moves @ x for x in (motion.q, motion.qd, motion.qdd))
        q += self._plus[:, None]
        for i in range(q.shape[1]):
            self._engine.setRobotState(base, q[:, i], still, qd[:, i], self._gravity)
            self._engine.inverseDynamicsInertialParametersRegressor(still, qdd[:, i], self._out)
            yield self._moves.T @ self._out.toNumPy()[6:]

    def _whole(self, bodies: Sequence[int], factor: float) -> Array:
        column: Array = np.zeros_like(self._nominal)
        column[list(bodies)] = factor * self._nominal[list(bodies)]
        return column

    def _one(self, body: int, at: int, value: float) -> Array:
        column: Array = np.zeros_like(self._nominal)
        column[body, at] = value
        return column


def _point(mass: float, at: Array) -> Array:
    """Inertial parameters of a mass at a place of the link's frame."""
    inertia = mass * (at @ at * np.eye(3) - np.outer(at, at))
    return np.array([mass, *(mass * at), *inertia[np.triu_indices(3)]])


def _joints(path: Path) -> tuple[dict[str, UrdfJoint], str]:
    """Read the joints that move, and name the link that most of them move."""
    text = read_text(path, "name the robot's .urdf file", largest=_LARGEST)
    try:
        robot = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise BadInput(
            str(path), f"is no XML ({error})", "give the URDF, as xacro makes it"
        ) from None
    if robot.tag != "robot" or robot.find("link") is None:
        raise BadInput(str(path), "is no URDF: it has no <robot> with links", "give the URDF")
    links = {str(link.get("name")) for link in robot.findall("link")}
    parents: dict[str, tuple[str, bool]] = {}
    found: dict[str, UrdfJoint] = {}
    for joint in robot.findall("joint"):
        name, kind = str(joint.get("name")), joint.get("type")
        ends = {
            e: str(getattr(joint.find(e), "attrib", {}).get("link")) for e in ("parent", "child")
        }
        if missing := [end for end in ends.values() if end not in links]:
            what = f"joint {name!r} names a link {missing[0]!r} that is not there"
            raise BadInput(str(path), what, nearest(missing[0], links))
        parents[ends["child"]] = (ends["parent"], kind in _MOTIONS)
        if kind in _MOTIONS:
            found[name] = _joint(path, joint, name, ends["child"])
        elif kind != "fixed":
            what = f"joint {name!r} is {kind}"
            raise BadInput(str(path), what, f"it can be {', '.join(_MOTIONS)} or fixed")
    for one in found.values():
        if one.mimics and (one.mimics[0] not in found or found[one.mimics[0]].mimics):
            what = f"joint {one.name!r} mimics {one.mimics[0]!r}, which does not move by itself"
            raise BadInput(str(path), what, "let it mimic one that does")
    if not found:
        raise BadInput(str(path), "has no joint that moves", "give the URDF of the arm")

    def depth(one: UrdfJoint) -> int:
        link, count, seen = one.child, 0, set[str]()
        while link in parents and link not in seen:
            seen.add(link)
            link, moves = parents[link]
            count += moves
        return count

    return found, max(found.values(), key=depth).child


def _joint(path: Path, joint: ElementTree.Element, name: str, child: str) -> UrdfJoint:
    def number(of: str, key: str, default: float) -> float:
        part = joint.find(of)
        try:
            value = float(default if part is None else part.get(key, default))
        except ValueError:
            value = np.nan
        if np.isnan(value):
            raise BadInput(str(path), f"joint {name!r}: {of} {key} is no number", "correct it")
        return value

    kind = str(joint.get("type"))
    mimic = joint.find("mimic")
    limits = (number("limit", "lower", -np.inf), number("limit", "upper", np.inf))
    return UrdfJoint(
        name,
        _MOTIONS[kind],
        child,
        (-np.inf, np.inf) if kind == "continuous" else limits,
        None
        if mimic is None
        else (
            str(mimic.get("joint")),
            number("mimic", "multiplier", 1.0),
            number("mimic", "offset", 0.0),
        ),
    )

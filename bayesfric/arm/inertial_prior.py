"""Rigid-body torques of a URDF, and a prior over its inertial parameters.

Rigid-body dynamics are iDynTree's. Its wheel takes 21 MB and NumPy; Pinocchio's, as fast and as
well maintained, brings Boost, Assimp, coal and others, 380 MB in all.

The regressor is linear in ten inertial parameters a body (Atkeson, An and Hollerbach 1986): mass,
first moment and inertia about the frame of its link. So a Gaussian over these, the URDF its mean,
is a Gaussian over the torque along any motion; one joint's torque on one motion depends on few
principal directions of it (singular value decomposition).

The parameters are those of a physical body if the pseudo-inertia ``[[S, h], [h', m]]`` is positive
definite, ``S = tr(I)/2 - I`` the second moments of mass (Traversaro et al. 2016; Wensing, Kim and
Slotine 2018).
"""

from __future__ import annotations

import math
import os
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from bayesfric.arm.arm_options import Coupling, Payload, Uncertainty, Vector, torque_columns
from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.safe_read import read_text
from bayesfric.estimates.autoregression import long_run_variance
from bayesfric.mechanism.quantities import Motion
from bayesfric.recordings.arrays import Array

PER_BODY = 10  # inertial parameters of a body
_MOTIONS: dict[str, Motion] = {"revolute": "rotary", "continuous": "rotary", "prismatic": "linear"}
_PARAMETERS = ("mass", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
_UNITS = ("kg", *("kg m",) * 3, *("kg m²",) * 6)


@dataclass(frozen=True)
class UrdfJoint:
    """A joint of the URDF that moves; SI."""

    name: str
    motion: Motion
    mimics: tuple[str, float, float] | None = None  # joint, multiplier, offset
    low: float = -math.inf  # limits of position
    high: float = math.inf
    speed: float = 0.0  # limits of size
    effort: float = 0.0


@dataclass(frozen=True, eq=False)
class InertialPrior:
    """A Gaussian over inertial parameters: ``nominal + spread @ z``, ``z`` standard normal.

    ``deviations`` holds name, standard deviation and unit of each component of ``z``.
    """

    nominal: Array  # (10 n_links,)
    spread: Array  # (10 n_links, n_deviations)
    deviations: Sequence[tuple[str, float, str]]
    feasible: Array  # (n_deviations,) a z of which the payload is a physical body
    payload: Array  # (10 n_links,) part of the nominal, as the last deviations are
    widths: Array | float = 1.0  # (n_deviations,) factors on the standard deviations as stated

    def widened(self, widths: Array) -> InertialPrior:
        """Multiply the standard deviations."""
        rows = zip(self.deviations, widths.tolist(), strict=True)
        deviations = [(name, sd * width, unit) for (name, sd, unit), width in rows]
        return replace(self, spread=self.spread * widths, deviations=deviations, widths=widths)

    def columns(self, *, loaded: bool) -> Array:
        """Stack nominal and spread, ``(10 n_links, 1 + n_deviations)``, with payload or without."""
        stacked = np.column_stack([self.nominal, self.spread])
        if not loaded:
            stacked[:, 0] -= self.payload
            stacked[:, -PER_BODY:] = 0.0
        return stacked


class Bodies:
    """The rigid bodies of a URDF whose root is fixed.

    ``joints`` are those that move and mimic none, by name; ``links`` the names of the bodies.
    ``gravity`` is in the frame of the root, m/s². Motion and torques are those of the joints, or,
    of joints with a ``coupling``, of their motors.
    """

    def __init__(self, path: Path, gravity: Vector, coupling: Coupling | None = None) -> None:
        all_joints = _joints(path)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # as an error one of SWIG's ends Python
                import idyntree.bindings as idyntree
        except ImportError as error:
            hint = "pip install 'bayesfric[arm]'"
            raise BadInput(str(path), "is a URDF, whose torques iDynTree computes", hint) from error
        loader = idyntree.ModelLoader()
        if complaint := _stderr_of(lambda: loader.loadModelFromFile(str(path))):
            raise BadInput(str(path), f"is no URDF of an arm: {complaint}", "look with check_urdf")
        model = loader.model()
        self.path = path
        self.joints = {name: joint for name, joint in all_joints.items() if joint.mimics is None}
        self.links = [model.getLinkName(k) for k in range(model.getNrOfLinks())]
        self.gravity, self._engine = gravity, idyntree.KinDynComputations()
        self._engine.loadRobotModel(model)
        self._idyntree, self._model = idyntree, model.copy()
        parameters = idyntree.VectorDynSize()
        model.getInertialParameters(parameters)
        self._nominal = parameters.toNumPy().reshape(-1, PER_BODY).copy()
        if not self._nominal[:, 0].any():
            raise BadInput(str(path), "no link has an <inertial> with a mass", "add it to links")
        self._regressor = idyntree.MatrixDynSize(6 + model.getNrOfDOFs(), self._nominal.size)
        # all coordinates of the model are _map @ q + _offset, torques of `joints` _map.T @ torque
        order = list(self.joints)
        self._map, self._offset = np.zeros((len(all_joints), len(order))), np.zeros(len(all_joints))
        for name in all_joints:
            at = model.getJoint(model.getJointIndex(name)).getDOFsOffset()
            source, multiplier, self._offset[at] = _followed(path, all_joints, name)
            self._map[at, order.index(source)] = multiplier
        for name in coupling.joints if coupling else ():
            if name not in order:
                problem = f"there is no joint {name!r}"
                raise BadInput("coupling.joints", problem, nearest(name, order))
        # positions of the motors per positions of the joints, where some are coupled
        self.motors = coupling.motors(order) if coupling and coupling.joints else None
        if self.motors is not None:
            self._map = self._map @ np.linalg.inv(self.motors)

    def under(self, gravity: Vector) -> Bodies:
        """Return the same bodies under another gravity."""
        bodies = copy(self)
        bodies.gravity = gravity
        return bodies

    def prior(self, uncertainty: Uncertainty, payload: Payload) -> InertialPrior:
        """Build the prior of the inertial parameters, with the payload."""
        moving_joints = self._moving_joints()
        # of several links that most joints move the last
        last = int(np.flatnonzero(moving_joints == moving_joints.max())[-1])
        link = payload.link or self.links[last]
        if link not in self.links:
            problem = f"there is no link {link!r}"
            raise BadInput("payload.link", problem, nearest(link, self.links))
        # name, sd, unit, body and change per unit of each deviation
        factor, rows = uncertainty.factor, list[tuple[str, float, str, int | slice, Array]]()
        rows.append(("all bodies", factor, "", slice(None), self._nominal))
        for k, name in enumerate(self.links):
            mass = self._nominal[k, 0]
            if mass and moving_joints[k]:
                rows.append((f"{name} by itself", factor, "", k, self._nominal[k]))
                for axis, change in _centre_shifts(self._nominal[k, 1:4] / mass).items():
                    name_of = f"centre of {name}, {axis}"
                    rows.append((name_of, uncertainty.centre, "m", k, mass * change))
        k, centre, mass_sd = self.links.index(link), np.array(payload.centre), payload.mass_sd
        moment_sd = (payload.mass + mass_sd) * payload.centre_sd
        rows.append((f"payload of {link}", mass_sd, "kg", k, _point_mass(centre)))
        for axis, change in _centre_shifts(centre).items():
            rows.append((f"moment of the payload, {axis}", moment_sd, "kg m", k, change))
        for i, axes in enumerate(("xx", "xy", "xz", "yy", "yz", "zz")):
            change = np.r_[np.zeros(4), inertia_of(tensor(np.eye(6)[i]))]
            name, sd = f"second moment of the payload, {axes}", moment_sd * payload.centre_sd
            rows.append((name, sd, "kg m²", k, change))
        spread = np.zeros((len(rows), *self._nominal.shape))
        for column, (_, sd, _, body, change) in zip(spread, rows, strict=True):
            column[body] = sd * change
        feasible = np.zeros(len(rows))
        feasible[-PER_BODY:] = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0
        known_payload = np.zeros_like(self._nominal)
        known_payload[k] = payload.mass * _point_mass(centre)
        return InertialPrior(
            (self._nominal + known_payload).ravel(),
            spread.reshape(len(rows), -1).T.copy(),
            [row[:3] for row in rows],
            feasible,
            known_payload.ravel(),
        )

    def torques(self, motion: Array, parameters: Array) -> Array:
        """Compute joint torques for inertial parameters, ``(n_joints, k, n)``, N m or N.

        ``motion`` is ``(3, n_joints, n)`` position, speed and acceleration of :attr:`joints`;
        ``parameters`` ``(n_joints, 10 n_links, k)`` holds k columns for each joint.
        """
        out = np.empty((motion.shape[2], len(parameters), parameters.shape[2]))
        for i, regressor in enumerate(self._regressors(motion)):
            out[i] = np.einsum("jp,jpk->jk", regressor, parameters)
        return np.moveaxis(out, 0, 2)

    def own_inertia(self, joint: str, position: Array, parameters: Array) -> Array:
        """Compute a joint's inertia ``(k, n)`` with all others held, kg m² or kg.

        ``position`` is ``(n_joints, n)``, ``parameters`` ``(10 n_links, k)``.
        """
        j, motion = list(self.joints).index(joint), np.zeros((3, *position.shape))
        motion[0], motion[2, j] = position, 1.0
        weightless = self.under((0.0, 0.0, 0.0))
        return np.stack([row[j] @ parameters for row in weightless._regressors(motion)], axis=1)

    def dynamics(self, parameters: Array) -> Callable[[Array, Array], tuple[Array, Array]]:
        """Return a function for forward dynamics with inertial parameters ``(10 n_links,)``.

        It maps position and speed ``(n_joints,)`` to the mass matrix ``(n_joints, n_joints)`` and
        the bias torque ``(n_joints,)``, which is that without acceleration.
        """
        vector, engine = self._idyntree.VectorDynSize, self._idyntree.KinDynComputations()
        self._model.updateInertialParameters(vector.FromPython(parameters))
        engine.loadRobotModel(self._model)  # which is a copy
        count = self._model.getNrOfDOFs()
        mass = self._idyntree.MatrixDynSize(6 + count, 6 + count)
        bias = self._idyntree.FreeFloatingGeneralizedTorques(self._model)
        base, still, gravity = np.eye(4), np.zeros(6), np.array(self.gravity)

        def mass_and_bias(q: Array, qd: Array) -> tuple[Array, Array]:
            engine.setRobotState(base, self._map @ q + self._offset, still, self._map @ qd, gravity)
            engine.getFreeFloatingMassMatrix(mass)
            engine.generalizedBiasForces(bias)
            inertia = self._map.T @ mass.toNumPy()[6:, 6:] @ self._map
            return inertia, self._map.T @ bias.jointTorques().toNumPy()

        return mass_and_bias

    def _regressors(self, motion: Array) -> Iterator[Array]:
        """Compute the regressor of every sample, ``(n_joints, 10 n_links)``."""
        base, still, gravity = np.eye(4), np.zeros(6), np.array(self.gravity)
        q, qd, qdd = (self._map @ x for x in motion)
        q += self._offset[:, None]
        out = self._regressor
        for i in range(q.shape[1]):
            self._engine.setRobotState(base, q[:, i], still, qd[:, i], gravity)
            self._engine.inverseDynamicsInertialParametersRegressor(still, qdd[:, i], out)
            yield self._map.T @ out.toNumPy()[6:]

    def _moving_joints(self) -> NDArray[np.int64]:
        """Count the joints whose torque depends on each link, ``(n_links,)``."""
        motion = np.ones((3, len(self.joints), 1))
        regressor = next(self._regressors(motion)).reshape(len(self.joints), -1, PER_BODY)
        return np.asarray(np.count_nonzero(np.abs(regressor).sum(axis=2) > 1e-9, axis=0))


def directions(columns: Array, threshold: float) -> Array:
    """Find the combinations of deviations that a joint's torque depends on, ``(n_deviations, k)``.

    They are orthonormal, so their coefficients are standard normal, too; the torque of all others
    has an rms below ``threshold``. ``columns`` ``(n_deviations, n)`` are torques of one sd each.
    """
    left, size, _ = np.linalg.svd(columns / np.sqrt(columns.shape[1]), full_matrices=False)
    beyond = np.sqrt(np.cumsum(size[::-1] ** 2)[::-1])
    return np.asarray(left[:, beyond > max(threshold, 1e-6 * beyond[0])])


def resolution(torque: Array, speed: Array, acceleration: Array, columns: Array) -> float:
    """Estimate the smallest rms torque that a log identifies: the standard error of a mean.

    It is that of the autocorrelated residual (Andrews 1991) of least squares on friction and
    ``columns`` ``(k, n)``, the rigid-body torque first.
    """
    x = np.vstack([columns, torque_columns(columns[0], speed, acceleration)]).T
    residual = torque - x @ np.linalg.lstsq(x, torque, rcond=None)[0]
    variance = long_run_variance(residual, np.arange(residual.size))
    return float(math.sqrt(variance) / residual.size)


def inertia_of(second: Array) -> Array:
    """Give the inertia ``(..., 6)`` of second moments ``(..., 3, 3)``, about the same point."""
    trace = np.trace(second, axis1=-2, axis2=-1)[..., None, None]
    rows, columns = np.triu_indices(3)
    return np.asarray((trace * np.eye(3) - second)[..., rows, columns])


def tensor(six: Array) -> Array:
    """Lay out ``(..., 6)``, xx, xy, xz, yy, yz, zz, as symmetric matrices ``(..., 3, 3)``."""
    return np.asarray(six[..., [[0, 1, 2], [1, 3, 4], [2, 4, 5]]])


def pseudo_inertias(parameters: Array) -> Array:
    """Give the pseudo-inertias ``(..., n, 4, 4)`` of ``(..., 10 n)`` parameters."""
    body = parameters.reshape(*parameters.shape[:-1], -1, PER_BODY)
    out, inertia = np.empty((*body.shape[:-1], 4, 4)), tensor(body[..., 4:])
    trace = np.trace(inertia, axis1=-2, axis2=-1)[..., None, None]
    out[..., :3, :3] = 0.5 * trace * np.eye(3) - inertia
    out[..., :3, 3] = out[..., 3, :3] = body[..., 1:4]
    out[..., 3, 3] = body[..., 0]
    return out


def feasible(parameters: Array) -> NDArray[np.bool_]:
    """Test which bodies ``(..., n)`` of ``(..., 10 n)`` parameters are physical, or nothing."""
    pseudo_inertia = pseudo_inertias(parameters)
    smallest = np.linalg.eigvalsh(pseudo_inertia)[..., 0]
    trace = np.trace(pseudo_inertia, axis1=-2, axis2=-1)
    return np.asarray((trace >= 0.0) & (smallest >= -1e-9 * np.abs(trace)))


def with_second_order(parameters: Array, nominal: Array) -> Array:
    """Add the second-order term of a shifted centre, ``(..., 10 n)`` both.

    A body shifted by ``d`` has second moments larger by ``m d d'``, which a Gaussian over
    parameters leaves out. That torque is negligible, but without it no body is physical.
    """
    body = parameters.reshape(*parameters.shape[:-1], -1, PER_BODY).copy()
    reference = nominal.reshape(-1, PER_BODY)
    mass = body[..., 0]
    heavy = reference[:, 0] > 0.0
    scale = np.divide(mass, reference[:, 0], out=np.zeros_like(mass), where=heavy)
    moment = body[..., 1:4] - scale[..., None] * reference[:, 1:4]
    inertia = inertia_of(moment[..., :, None] * moment[..., None, :])
    positive = mass[..., None] > 0.0
    body[..., 4:] += np.divide(inertia, mass[..., None], out=np.zeros_like(inertia), where=positive)
    return np.asarray(body.reshape(parameters.shape))


def sample_feasible(
    nominal: Array,
    spread: Array,
    mean: Array,
    covariance: Array,
    start: Array,
    rng: np.random.Generator,
    *,
    chains: int = 400,
    steps: int = 150,
) -> tuple[Array, float]:
    """Sample a Gaussian over ``z``, truncated to where all bodies are physical.

    These are :func:`with_second_order` of ``nominal + spread @ z``; links that are not physical at
    ``start`` are not tested. By elliptical slice sampling (Murray, Adams and MacKay 2010), in so
    many steps that forty deviations are independent of the start. Returns draws ``(chains, k)`` and
    the share of the Gaussian's own draws that are feasible.
    """
    tested = feasible(with_second_order(nominal + spread @ start, nominal))

    def inside(z: Array) -> NDArray[np.bool_]:
        physical = feasible(with_second_order(nominal + z @ spread.T, nominal))
        return np.asarray(physical[..., tested].all(axis=-1))

    root = np.linalg.cholesky(covariance)

    def draw() -> Array:
        return np.asarray(rng.normal(size=(chains, mean.size)) @ root.T)

    share = float(np.mean(inside(mean + draw())))
    state = np.tile(start - mean, (chains, 1))
    for _ in range(steps):
        auxiliary, angle = draw(), rng.uniform(0.0, 2.0 * np.pi, chains)
        low, high, active = angle - 2.0 * np.pi, angle.copy(), np.arange(chains)
        previous = state.copy()
        for _ in range(60):  # the slice shrinks
            at = angle[active, None]
            proposal = previous[active] * np.cos(at) + auxiliary[active] * np.sin(at)
            accepted = inside(mean + proposal)
            state[active[accepted]] = proposal[accepted]
            active = active[~accepted]
            if not active.size:
                break
            low[active] = np.where(angle[active] < 0.0, angle[active], low[active])
            high[active] = np.where(angle[active] < 0.0, high[active], angle[active])
            angle[active] = rng.uniform(low[active], high[active])
    return mean + state, share


def _point_mass(at: Array) -> Array:
    """Inertial parameters of a point of 1 kg at a position in the link's frame."""
    return np.array([1.0, *at, *inertia_of(np.outer(at, at))])


def _centre_shifts(centre: Array) -> dict[str, Array]:
    """Differentiate the inertial parameters per kg by shifts of the centre along each axis, 1/m."""
    shifts = {}
    for axis, unit in zip("xyz", np.eye(3), strict=True):
        second = np.outer(centre, unit) + np.outer(unit, centre)
        shifts[axis] = np.array([0.0, *unit, *inertia_of(second)])
    return shifts


# -- base parameters: combinations of inertial parameters that torques depend on (Gautier 1991)


def combinations(bodies: Bodies, *, rounding: float = 1e-8) -> tuple[Array, Array]:
    """Find the base parameters of an arm, independent of its motion.

    Of the regressor's columns along random motions, root to tip, each is either independent of
    those before or a linear combination of them. Returns the index ``(r,)`` of the first inertial
    parameter of each, and their coefficients ``(r, 10 n_links)``, which are 1 for the first.
    """
    count, n = len(bodies.joints), PER_BODY * len(bodies.links)
    motion = np.random.default_rng(0).uniform(-2.0, 2.0, (3, count, 120))
    identity = np.broadcast_to(np.eye(n), (count, n, n))
    columns = np.moveaxis(bodies.torques(motion, identity), 1, 2).reshape(-1, n)
    triangle = np.linalg.qr(columns).R
    basis, first = np.zeros((len(triangle), 0)), list[int]()
    for k in range(n):
        column = triangle[:, k]
        residual = column - basis @ (basis.T @ column)
        if np.linalg.norm(residual) > rounding * np.linalg.norm(triangle):
            first.append(k)
            basis = np.linalg.qr(triangle[:, first])[0]
    q, r = np.linalg.qr(triangle[:, first])
    coefficients = solve_triangular(r, q.T @ triangle)
    return np.array(first), np.where(np.abs(coefficients) > 1e3 * rounding, coefficients, 0.0)


def base_parameters(bodies: Bodies, prior: InertialPrior, draws: Array) -> list[dict[str, Any]]:
    """Give the posterior of the base parameters, those first whose sd the data reduce most.

    ``draws`` ``(n, n_deviations)`` are of the deviations of an inertial prior. Each has the keys of
    ``arm.json``: ``name`` of its first inertial parameter, ``beside`` the factors of the others.
    """
    names = [f"{parameter} of {link}" for link in bodies.links for parameter in _PARAMETERS]
    first, coefficients = combinations(bodies)
    urdf, slopes = coefficients @ prior.nominal, coefficients @ prior.spread
    value, sd = urdf + slopes @ draws.mean(axis=0), (draws @ slopes.T).std(axis=0)
    prior_sd = np.sqrt(np.sum(slopes**2, axis=1))
    contraction = np.divide(sd, prior_sd, out=np.ones_like(sd), where=prior_sd > 0.0)
    rows = []
    for i in np.argsort(contraction):
        others = [k for k in np.flatnonzero(coefficients[i]) if k != first[i]]
        beside = {names[k]: float(coefficients[i, k]) for k in others}
        row = {"name": names[first[i]], "beside": beside, "unit": _UNITS[first[i] % PER_BODY]}
        numbers = {"value": value[i], "sd": sd[i], "urdf": urdf[i], "urdf_sd": prior_sd[i]}
        rows.append(row | {key: float(x) for key, x in numbers.items()})
    return rows


# -- reading the URDF


def urdf_text(path: Path) -> str:
    """Read the text of a URDF."""
    return read_text(path, "name the robot's .urdf file", largest=10_000_000)


def _joints(path: Path) -> dict[str, UrdfJoint]:
    """Read the joints that move: their limits and mimics, which iDynTree does not give."""
    joints = {}
    try:
        for joint in ElementTree.fromstring(urdf_text(path)).findall("joint"):
            name, kind = joint.get("name", ""), joint.get("type", "")
            limit, mimic = (getattr(joint.find(tag), "attrib", {}) for tag in ("limit", "mimic"))
            if kind not in _MOTIONS:
                continue
            keys = ("lower", "upper", "velocity", "effort")
            low, high, speed, effort = (float(limit.get(key, 0)) for key in keys)
            if kind == "continuous" or low >= high:  # the latter means that there is no limit
                low, high = -math.inf, math.inf
            multiplier, offset = float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0))
            source = (mimic.get("joint", ""), multiplier, offset) if mimic else None
            joints[name] = UrdfJoint(name, _MOTIONS[kind], source, low, high, speed, effort)
    except (ElementTree.ParseError, ValueError) as error:
        raise BadInput(str(path), f"is no URDF ({error})", "give what xacro makes") from None
    if not joints:
        raise BadInput(str(path), "has no joint that moves", "give the URDF of an arm")
    return joints


def _followed(path: Path, joints: Mapping[str, UrdfJoint], name: str) -> tuple[str, float, float]:
    """Follow a chain of mimics to the joint that moves: its name, multiplier and offset."""
    source, multiplier, offset = name, 1.0, 0.0
    for _ in joints:
        mimics = joints[source].mimics
        if mimics is None:
            return source, multiplier, offset
        source, factor, shift = mimics
        multiplier, offset = multiplier * factor, offset + multiplier * shift
        if source not in joints:
            raise BadInput(str(path), f"{name!r} mimics {source!r}", nearest(source, joints))
    problem = f"{name!r} mimics joints that mimic each other"
    raise BadInput(str(path), problem, "let one of them move by itself")


def _stderr_of(load: Callable[[], Any]) -> str:
    """Call a function, and return the first complaint on stderr, where C++ libraries write.

    After these iDynTree reads on although it should not.
    """
    with tempfile.TemporaryFile() as captured:
        stderr = os.dup(2)
        os.dup2(captured.fileno(), 2)
        try:
            load()
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
        captured.seek(0)
        lines = captured.read().decode("utf-8", "replace").splitlines()
    refused = ("[ERROR]", "[WARNING] InertiaElement")
    complaint = next((line for line in lines if line.startswith(refused)), "")
    return complaint.rpartition(" : ")[2].strip()

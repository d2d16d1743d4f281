"""Legged robot in a MuJoCo model: feet, motors, kinematics and dynamics."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any, Iterator, NamedTuple, Optional, Sequence, Union
from xml.etree import ElementTree

import numpy as np

from .. import Error
from . import _rotation, _sole
from ._engine import Floats, mj

Path = Union[str, "os.PathLike[str]"]

#: Largest height of a stance foot above the lowest foot, as a share of the height of the centre of mass above that foot.
LEVEL = 0.1
#: Smallest height of the leg's first joint above the foot in a stance, as a share of the leg's length.
DROP = 0.3
#: Largest longitudinal distance between foot and first joint in a stance, as a share of that height.
LEAN = 0.6
#: Smallest singular value of the foot's Jacobian in a stance, as a share of the leg's length. It is smaller for a stretched leg.
BEND = 0.1
#: Joint angles, rad, that are tried for legs with three joints if no pose of the model is a stance; the negative angles are tried as well.
BENT = (0.0, 0.85, -1.7)
#: Distance that joints keep from the ends of their ranges, rad or m.
SPARE = 0.05
#: Largest remaining error of inverse kinematics, m and rad, with which a pose counts as attained.
ATTAINED = 1e-4
#: Smallest number of joints of a leg whose foot can be a sole.
SOLE_JOINTS = 6
#: Height of the centre of mass below the largest one, as a share of it, in the stance on soles of a model whose reach is not known.
CROUCH = 0.055
#: Share of the distance to the middle of their ranges by which joints are bent before the stance on soles is searched, and heights of the
#: centre of mass that are tried, as shares of that in the given pose.
PREBENT, HEIGHTS = 0.1, np.linspace(0.75, 1.25, 51)

#: Mass, kg, and moment of inertia, kg m², of links of a URDF file that have less.
LEAST = (1e-6, 1e-9)
#: Name of the body of a load, which no model uses, and length of the sides of its cube, m.
LOAD, LOAD_SIZE = "cregopt load", 0.1


@dataclass(frozen=True)
class Foot:
    """End of a leg: a ball, a point or a sole."""

    name: str
    #: Index of the body that carries the foot.
    body: int
    #: Index of the geom that touches the ground; None for a sole and for a foot that is a site, which touch it with any geom.
    geom: Optional[int]
    #: Centre of the ball or of the rectangle of the sole, frame of the body, m.
    center: Floats
    #: Radius of the ball, m; 0 for a point and for a sole.
    radius: float
    #: Indices of the degrees of freedom of the leg, from the base outwards.
    dofs: tuple[int, ...]
    #: Sole, or None for a ball or a point.
    sole: Optional[_sole.Sole] = None


class State(NamedTuple):
    """State of the robot at an instant, as the controller knows it. World frame, SI units, n degrees of freedom."""

    #: Positions of the joints, shape (n - 6,), and velocities of the degrees of freedom, MuJoCo's ``qvel``, shape (n,).
    joints: Floats
    velocity: Floats
    #: Position and velocity of the centre of mass, shape (3,).
    com: Floats
    com_velocity: Floats
    #: Rotation matrix from base to world, shape (3, 3), and angular velocity of the base, shape (3,).
    rotation: Floats
    angular_velocity: Floats
    #: Positions of the centres of the feet, shape (feet, 3), and attitudes of the soles (of the bodies of other feet), shape (feet, 3, 3).
    feet: Floats
    soles: Floats
    #: Inertia matrix, shape (n, n), and generalised forces at which all accelerations are zero, shape (n,).
    inertia: Floats
    bias: Floats


class Machine:
    """Robot with a free base and legs, all of whose joints have motors, unless ``motors`` is False.

    ``spec`` is the model without the geometry of its world, so that a ground can be added.
    """

    def __init__(self, path: Path, feet: Optional[Sequence[str]] = None, count: Optional[int] = None, motors: bool = True) -> None:
        self.name = os.path.splitext(os.path.basename(os.fspath(path)))[0]
        self.spec = _read(path)
        self.model = self.spec.compile()
        # The controller computes with this copy, without contacts, actuators and constraints.
        off = mj.mjtDisableBit
        self.model.opt.disableflags |= off.mjDSBL_CONTACT | off.mjDSBL_ACTUATION | off.mjDSBL_CONSTRAINT
        self.data = mj.MjData(self.model)
        self.base = self._free_base()
        self.torque_limits = self._torque_limits() if motors else np.full(self.model.nv - 6, np.inf)
        self.mass = float(self.model.body_subtreemass[self.base])
        self.feet: list[Foot] = []
        self._pose(_level(next(self._poses())))
        ends = list(self._ends())
        if feet is not None:
            self.feet = [self._named_foot(name, ends) for name in feet]
        else:
            self.feet = ends
        self.stance = self._stance()
        if feet is None:
            self._pose(self.stance)
            self.feet = sorted(self._lowest(), key=self._front_left_first)
        if self.soled:
            self.stances = self._stances()
            self.stance = self.crouched(CROUCH)
        #: Indices of the joints that belong to no leg or to several, not counting the base.
        self.limbless = [joint for joint in range(self.model.nv - 6) if joint + 6 not in self._leg_dofs()]
        if count is not None and len(self.feet) != count:
            seen = ", ".join(foot.name for foot in self.feet) or "none"
            raise Error(f"the model {self.name} has {len(self.feet)} feet ({seen}), the plan {count}: name the feet of the plan (--feet)")
        if not self.feet:
            raise Error(f"the model {self.name} has no feet (soles, balls or ends of capsules at the ends of legs): name them (--feet)")

    def add_load(self, mass: float, place: Floats) -> None:
        """Adds a mass, kg, at a place of the base, frame of its body, m: to ``spec``, not to the model with which the controller computes."""
        base = next(body for body in self.spec.bodies if body.id == self.base)
        # A child: geoms do not change the mass of a body whose inertia is given. Without contact.
        body = base.add_body(name=LOAD, pos=place)
        size = [LOAD_SIZE / 2] * 3
        body.add_geom(type=mj.mjtGeom.mjGEOM_BOX, size=size, mass=mass, contype=0, conaffinity=0, rgba=[0.85, 0.45, 0.1, 1])

    # Content of the model.

    def _free_base(self) -> int:
        """Index of the body with the free joint. Raises Error unless all other joints are hinges or slides."""
        m = self.model
        if m.njnt == 0 or int(m.jnt_type[0]) != int(mj.mjtJoint.mjJNT_FREE):
            raise Error(f"the model {self.name} has no free joint at its base")
        if not set(m.jnt_type[1:].tolist()) <= {int(mj.mjtJoint.mjJNT_HINGE), int(mj.mjtJoint.mjJNT_SLIDE)}:
            raise Error(f"the model {self.name} has joints that are neither hinges nor slides, or a second free body")
        return int(m.jnt_bodyid[0])

    def _torque_limits(self) -> Floats:
        """Largest torque of each joint, N m (N for slides), shape (joints,); infinite if the model has no limit."""
        m = self.model
        limits = np.zeros(m.nv - 6)
        drive = {int(mj.mjtTrn.mjTRN_JOINT), int(mj.mjtTrn.mjTRN_JOINTINPARENT)}
        for actuator in range(m.nu):
            joint = m.actuator_trnid[actuator, 0]
            if int(m.actuator_trntype[actuator]) not in drive or m.jnt_dofadr[joint] < 6:
                raise Error(f"motor {m.actuator(actuator).name or actuator} of the model {self.name} drives no joint")
            force = float(m.actuator_forcerange[actuator, 1]) if m.actuator_forcelimited[actuator] else np.inf
            # The control range of a torque motor limits its torque as well.
            if m.actuator_ctrllimited[actuator] and int(m.actuator_biastype[actuator]) == int(mj.mjtBias.mjBIAS_NONE):
                force = min(force, float(m.actuator_ctrlrange[actuator, 1] * m.actuator_gainprm[actuator, 0]))
            limits[m.jnt_dofadr[joint] - 6] += force * abs(m.actuator_gear[actuator, 0])
        for joint in range(1, m.njnt):
            dof = m.jnt_dofadr[joint] - 6
            if limits[dof] == 0:
                raise Error(f"joint {m.joint(joint).name} of the model {self.name} has no motor")
            if m.jnt_actfrclimited[joint]:
                limits[dof] = min(limits[dof], m.jnt_actfrcrange[joint, 1])
        return limits

    def _chain(self, body: int) -> tuple[int, ...]:
        """Indices of the degrees of freedom between the base and a body, from the base outwards."""
        m, dofs = self.model, []
        while body not in (self.base, 0):
            first = m.body_dofadr[body]
            dofs += list(range(first, first + m.body_dofnum[body]))[::-1]
            body = m.body_parentid[body]
        return tuple(int(dof) for dof in dofs[::-1])

    def _ends(self) -> Iterator[Foot]:
        """Sole or outermost ball or capsule end of each limb."""
        m = self.model
        welded = [int(w) for w in m.body_weldid]
        inner = {welded[m.body_parentid[body]] for body in range(1, m.nbody) if welded[body] == body}
        for end in sorted({w for w in welded if w not in inner and w != 0}):
            geoms = [geom for geom in range(m.ngeom) if welded[m.geom_bodyid[geom]] == end and self._touches(geom)]
            sole = self._sole(end, geoms)
            balls = [foot for geom in geoms for foot in self._ball(geom)]
            if sole is not None:
                yield sole
            elif balls:
                yield max(balls, key=self._reaches_out)

    def _touches(self, geom: int) -> bool:
        """True if a geom can be in contact."""
        return bool(self.model.geom_contype[geom] or self.model.geom_conaffinity[geom])

    def _sole(self, body: int, geoms: list[int]) -> Optional[Foot]:
        """Sole of a body with these geoms, which is about level in the current pose; None without one, or if the limb cannot orient it."""
        dofs = self._chain(body)
        shapes = [_sole.balls(self.model, self.data, geom) for geom in geoms]
        if len(dofs) < SOLE_JOINTS or not shapes:
            return None
        radii = np.concatenate([np.full(len(centers), radius) for centers, radius in shapes])
        found = _sole.find(np.concatenate([centers for centers, _ in shapes]), radii)
        if found is None:
            return None
        to_body = self.data.xmat[body].reshape(3, 3).T
        sole = _sole.Sole(to_body @ found.axes, found.length, found.width)
        name = self.model.body(body).name or f"body {body}"
        return Foot(name, body, None, to_body @ (found.center - self.data.xpos[body]), 0.0, dofs, sole)

    def _ball(self, geom: int) -> Iterator[Foot]:
        """Possible feet of a geom that can be in contact: a ball, or both ends of a capsule."""
        m = self.model
        kind, ball, capsule = int(m.geom_type[geom]), int(mj.mjtGeom.mjGEOM_SPHERE), int(mj.mjtGeom.mjGEOM_CAPSULE)
        if not self._touches(geom) or kind not in (ball, capsule):
            return
        radius, half = float(m.geom_size[geom, 0]), float(m.geom_size[geom, 1]) if kind == capsule else 0.0
        axis = np.zeros(9)
        mj.mju_quat2Mat(axis, m.geom_quat[geom])
        body = int(m.geom_bodyid[geom])
        name = m.geom(geom).name or m.body(body).name or f"geom {geom}"
        for offset in (-half, half) if half else (0.0,):
            yield Foot(name, body, geom, m.geom_pos[geom] + offset * axis[2::3], radius, self._chain(body))

    def _reaches_out(self, foot: Foot) -> float:
        """Distance of the foot from the last joint of its leg, m."""
        mj.mj_kinematics(self.model, self.data)
        return float(np.linalg.norm(self.place(foot) - self.data.xanchor[self.model.dof_jntid[foot.dofs[-1]]])) if foot.dofs else 0.0

    def _named_foot(self, name: str, ends: list[Foot]) -> Foot:
        """Foot with the given name of a geom, body or site."""
        m, kind = self.model, mj.mjtObj
        geom, body, site = (int(mj.mj_name2id(m, of, name)) for of in (kind.mjOBJ_GEOM, kind.mjOBJ_BODY, kind.mjOBJ_SITE))
        found: list[Foot] = []
        if geom >= 0:
            found = list(self._ball(geom))
        elif body >= 0:
            found = [end for end in ends if m.body_weldid[end.body] == m.body_weldid[body]]
        elif site >= 0:
            on = int(m.site_bodyid[site])
            found = [Foot(name, on, None, m.site_pos[site].copy(), 0.0, self._chain(on))]
        else:
            seen = ", ".join(end.name for end in ends) or "none"
            raise Error(f"the model {self.name} has no geom, body or site {name!r}; at the ends of its legs are: {seen}")
        if not found:
            raise Error(
                f"{name!r} of the model {self.name} is not a foot: neither a ball or capsule that can be in contact, nor a body with one or with a "
                "sole, nor a site"
            )
        return max(found, key=self._reaches_out)

    # Stance.

    def _poses(self) -> Iterator[Floats]:
        """Poses (``qpos``) that may be a stance: keyframes, bent legs, and the model's default."""
        m = self.model
        names = [m.key(key).name for key in range(m.nkey)]
        for key in sorted(range(m.nkey), key=lambda key: (names[key] not in ("home", "stand", "standing"), key)):
            yield m.key_qpos[key].copy()
        for sign in (1.0, -1.0):
            pose = m.qpos0.copy()
            for foot in self.feet:
                if len(foot.dofs) == len(BENT):
                    pose[np.array(foot.dofs) + 1] = sign * np.array(BENT)
            if self.within_ranges(pose):
                yield pose
        yield m.qpos0.copy()

    def _stance(self) -> Floats:
        """First pose (``qpos``) whose feet are well below the robot, level at the origin; the model's default if no pose is."""
        m = self.model
        limited = np.flatnonzero(m.jnt_limited[1:]) + 1
        low, high = m.jnt_range[limited].T
        spare = np.minimum(2 * SPARE, (high - low) / 4)
        for pose in self._poses():
            pose = _level(pose)
            at = m.jnt_qposadr[limited]
            pose[at] = np.clip(pose[at], low + spare, high - spare)
            self._pose(pose)
            lowest = self._lowest()
            if lowest and all(self._stands_on(foot) for foot in lowest):
                return pose
        return pose

    def _stands_on(self, foot: Foot) -> bool:
        """True if a foot of the current pose is well below the first joint of its leg, and the leg is bent."""
        anchors = [self.data.xanchor[self.model.dof_jntid[dof]] for dof in foot.dofs]
        if not anchors:
            return False
        points = np.array([*anchors, self.place(foot)])
        length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        ahead, _, drop = points[0] - points[-1]
        jacobian = np.zeros((3, self.model.nv))
        mj.mj_jac(self.model, self.data, jacobian, None, points[-1], foot.body)
        moves = np.linalg.svd(jacobian[:, list(foot.dofs)], compute_uv=False).min()
        # The knees above soles are bent later.
        return bool(drop > DROP * length and abs(ahead) < LEAN * drop and (foot.sole is not None or moves > BEND * length))

    def _stances(self) -> list[tuple[float, Floats]]:
        """Heights of the centre of mass, m, and poses with bent knees, level soles, and the centre of mass above them; made from the stance."""
        m = self.model
        self._pose(self.stance)
        places = np.array([self.place(foot) for foot in self.feet])
        feet = (places - places.mean(axis=0)) * [0, 1, 0]
        height = float(self.center_of_mass()[2] - places[:, 2].mean())
        # A stretched knee bends towards the middle of its range.
        joints = np.array([m.dof_jntid[dof] for foot in self.feet for dof in foot.dofs])
        joints = joints[m.jnt_limited[joints] != 0]
        at = m.jnt_qposadr[joints]
        self.stance = self.stance.copy()
        self.stance[at] += PREBENT * (m.jnt_range[joints].mean(axis=1) - self.stance[at])
        poses: list[tuple[float, Floats]] = []
        for share in HEIGHTS:
            com = np.array([0, 0, share * height])
            left, pose = self.inverse_kinematics(com, np.eye(3), feet, np.tile(np.eye(3), (len(feet), 1, 1)))
            if left < ATTAINED and self.within_ranges(pose):
                poses.append((share * height, pose))
                self.stance = pose
        return poses or [(height, self.stance)]

    def crouched(self, share: float) -> Floats:
        """Stance on soles whose centre of mass is lower than with stretched legs by a share of its height."""
        wanted = (1 - share) * max(height for height, _ in self.stances)
        return min(self.stances, key=lambda of: abs(of[0] - wanted))[1]

    def _lowest(self) -> list[Foot]:
        """Feet that are in the current pose about as low as the lowest foot."""
        heights = [float(self.place(foot)[2]) - foot.radius for foot in self.feet]
        lowest = min(heights, default=0.0)
        above = float(self.center_of_mass()[2]) - lowest
        return [foot for foot, height in zip(self.feet, heights) if height - lowest < LEVEL * above]

    def _front_left_first(self, foot: Foot) -> tuple[float, float]:
        """Sort key: rows of feet from front to back, each from left to right."""
        self._pose(self.stance)
        x, y, _ = self.place(foot)
        length = max(abs(self.place(other)[0]) for other in self.feet) + 1e-9
        return -round(x / length * 4), -y

    # Kinematics.

    @property
    def soled(self) -> bool:
        """True if all feet are soles."""
        return bool(self.feet) and all(foot.sole is not None for foot in self.feet)

    def _pose(self, qpos: Floats) -> None:
        self.data.qpos[:] = qpos
        mj.mj_kinematics(self.model, self.data)
        mj.mj_comPos(self.model, self.data)

    def place(self, foot: Foot) -> Floats:
        """Centre of a foot in the current pose, world frame, m."""
        rotation = self.data.xmat[foot.body].reshape(3, 3)
        return self.data.xpos[foot.body] + rotation @ foot.center  # type: ignore[no-any-return]

    def attitude(self, foot: Foot) -> Floats:
        """Rotation matrix from the axes of a sole to the world in the current pose; from those of the body without a sole."""
        rotation: Floats = self.data.xmat[foot.body].reshape(3, 3).copy()
        return rotation if foot.sole is None else rotation @ foot.sole.axes

    def center_of_mass(self) -> Floats:
        """Centre of mass in the current pose, world frame, m."""
        return self.data.subtree_com[self.base].copy()  # type: ignore[no-any-return]

    def nominal_feet(self) -> Floats:
        """Contact points of the feet in the stance, relative to the centre of mass, base frame, m, shape (feet, 3)."""
        self._pose(self.stance)
        return np.array([self.place(foot) - [0, 0, foot.radius] for foot in self.feet]) - self.center_of_mass()

    def composite_inertia(self) -> Floats:
        """Inertia of the whole robot in the stance about its centre of mass, base frame, kg m², shape (3, 3)."""
        self._pose(self.stance)
        total, com = np.zeros((3, 3)), self.center_of_mass()
        for body in range(1, self.model.nbody):
            axes, arm = self.data.ximat[body].reshape(3, 3), self.data.xipos[body] - com
            own = axes @ np.diag(self.model.body_inertia[body]) @ axes.T
            total += own + self.model.body_mass[body] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        return (total + total.T) / 2

    def _leg_dofs(self) -> list[int]:
        """Indices of the degrees of freedom that belong to one leg."""
        dofs = [dof for foot in self.feet for dof in foot.dofs]
        return sorted(dof for dof in dofs if dofs.count(dof) == 1)

    def leg_mass(self) -> float:
        """Point mass at a foot with the moment of inertia of its leg (of the centres of its parts) about the hip, in the stance, kg: mean of the legs."""
        self._pose(self.stance)
        m, d, masses = self.model, self.data, []
        for foot in self.feet:
            own = [dof for dof in foot.dofs if dof in self._leg_dofs()]
            hip = d.xanchor[m.dof_jntid[own[0]]]
            parts = [body for body in range(1, m.nbody) if set(own) & set(self._chain(body))]
            moment = float(m.body_mass[parts] @ ((d.xipos[parts] - hip) ** 2).sum(axis=1))
            masses.append(moment / float(((self.place(foot) - hip) ** 2).sum()))
        return float(np.mean(masses))

    def inverse_kinematics(self, com: Floats, rotation: Floats, feet: Floats, soles: Floats) -> tuple[float, Floats]:
        """Pose with the given centre of mass ``com``, attitude ``rotation``, centres of the feet and attitudes of the soles, world frame, m.

        Joints that belong to no leg or to several keep their values of the stance. ``soles``: shape (feet, 3, 3), without effect for other feet.

        Returns the largest remaining error, m and rad, and the pose as MuJoCo's ``qpos``.
        """
        m, d = self.model, self.data
        d.qpos[:] = self.stance
        d.qpos[:3] = com
        mj.mju_mat2Quat(d.qpos[3:7], rotation.flatten())
        free = [0, 1, 2, *self._leg_dofs()]
        turning = [f for f, foot in enumerate(self.feet) if foot.sole is not None]
        jacobian = np.zeros((len(self.feet) + len(turning) + 1, 3, m.nv))
        turns = jacobian[len(self.feet) : -1]
        for _ in range(60):
            self._pose(d.qpos.copy())
            for foot, rows in zip(self.feet, jacobian):
                mj.mj_jac(m, d, rows, None, self.place(foot), foot.body)
            for f, rows in zip(turning, turns):
                mj.mj_jac(m, d, None, rows, self.place(self.feet[f]), self.feet[f].body)
            mj.mj_jacSubtreeCom(m, d, jacobian[-1], self.base)
            away = feet - np.array([self.place(foot) for foot in self.feet])
            turned = [_rotation.between(self.attitude(self.feet[f]), soles[f]) for f in turning]
            missing = np.concatenate([away.ravel(), *turned, com - self.center_of_mass()])
            if np.abs(missing).max() < 1e-7:
                break
            active = jacobian.reshape(-1, m.nv)[:, free]
            step = active.T @ np.linalg.solve(active @ active.T + 1e-6 * np.eye(len(missing)), missing)
            move = np.zeros(m.nv)
            # Steps are limited so that knees do not flip.
            move[free] = step * min(1.0, 0.3 / np.abs(step).max())
            mj.mj_integratePos(m, d.qpos, move, 1.0)
        return float(np.abs(missing).max()), d.qpos.copy()

    def within_ranges(self, qpos: Floats) -> bool:
        """True if all joints are within their ranges, with a margin of SPARE."""
        m = self.model
        at = m.jnt_qposadr[1:]
        inside = (m.jnt_range[1:, 0] + SPARE <= qpos[at]) & (qpos[at] <= m.jnt_range[1:, 1] - SPARE)
        return bool(np.all(inside | (m.jnt_limited[1:] == 0)))

    # Dynamics.

    def state(self, qpos: Floats, qvel: Floats) -> State:
        """State for the controller at ``qpos`` and ``qvel``. Afterwards :meth:`jacobian` refers to this state."""
        m, d = self.model, self.data
        d.qpos[:], d.qvel[:] = qpos, qvel
        mj.mj_forward(m, d)
        inertia, unit = np.zeros((m.nv, m.nv)), np.eye(m.nv)
        for row, axis in zip(inertia, unit):
            mj.mj_mulM(m, d, row, axis)
        com = np.zeros((3, m.nv))
        mj.mj_jacSubtreeCom(m, d, com, self.base)
        rotation = d.xmat[self.base].reshape(3, 3).copy()
        return State(
            joints=d.qpos[7:].copy(),
            velocity=d.qvel.copy(),
            com=self.center_of_mass(),
            com_velocity=com @ d.qvel,
            rotation=rotation,
            angular_velocity=rotation @ d.qvel[3:6],
            feet=np.array([self.place(foot) for foot in self.feet]),
            soles=np.array([self.attitude(foot) for foot in self.feet]),
            inertia=inertia,
            bias=d.qfrc_bias - d.qfrc_passive,
        )

    def jacobian(self, foot: Foot, point: Floats) -> tuple[Floats, Floats]:
        """Jacobian of the point of a foot that is at ``point``, world frame, m, in the last state.

        Returns the Jacobian, shape (3, n), and the acceleration of the point when all accelerations of degrees of freedom are zero, shape (3,), m/s².
        """
        m, d = self.model, self.data
        jacobian, rate = np.zeros((3, m.nv)), np.zeros((3, m.nv))
        mj.mj_jac(m, d, jacobian, None, point, foot.body)
        mj.mj_jacDot(m, d, rate, None, point, foot.body)
        return jacobian, rate @ d.qvel

    def turning(self, foot: Foot) -> tuple[Floats, Floats]:
        """Like :meth:`jacobian`, for the rotation of a foot: rad instead of m."""
        m, d = self.model, self.data
        jacobian, rate = np.zeros((3, m.nv)), np.zeros((3, m.nv))
        point = self.place(foot)
        mj.mj_jac(m, d, None, jacobian, point, foot.body)
        mj.mj_jacDot(m, d, None, rate, point, foot.body)
        return jacobian, rate @ d.qvel


def _level(pose: Floats) -> Floats:
    """Pose (``qpos``) with the base at the origin and level."""
    return np.concatenate([[0.0, 0, 0, 1, 0, 0, 0], pose[7:]])


def _read(path: Path) -> Any:
    """Model of a file without the geometry of its world."""
    if not os.path.isfile(path):
        raise Error(f"{os.fspath(path)}: there is no such model file")
    try:
        spec = mj.MjSpec.from_file(os.fspath(path))
        if ElementTree.parse(path).getroot().tag == "robot":
            _complete(spec)
        world = {geom.name for geom in spec.worldbody.geoms}
        for pair in list(spec.pairs):
            # A geom that is in contact with the world by a pair is in contact with the ground by itself.
            for one, other in ((pair.geomname1, pair.geomname2), (pair.geomname2, pair.geomname1)):
                if one in world and other not in world:
                    spec.geom(other).contype = 1
            if world & {pair.geomname1, pair.geomname2}:
                spec.delete(pair)
        for geom in list(spec.worldbody.geoms):
            spec.delete(geom)
        spec.compile()
    except (ValueError, RuntimeError, ElementTree.ParseError) as error:
        raise Error(f"{os.fspath(path)}: {error}") from error
    return spec


def _complete(spec: Any) -> None:
    """Adds what a URDF file does not have: a free base, and a motor for each joint, with its effort as the limit. Links without mass between
    joints get the least one. Meshes whose files MuJoCo does not find, such as those of ``package://``, are left out."""
    spec.compiler.boundmass, spec.compiler.boundinertia = LEAST
    base = spec.worldbody.first_body()
    if base is not None and base.first_joint() is None:
        base.add_freejoint()
    driven = {actuator.target for actuator in spec.actuators}
    for joint in spec.joints:
        if joint.type in (mj.mjtJoint.mjJNT_HINGE, mj.mjtJoint.mjJNT_SLIDE) and joint.name not in driven:
            spec.add_actuator(name=joint.name, target=joint.name, trntype=mj.mjtTrn.mjTRN_JOINT)
    absent = {mesh.name for mesh in spec.meshes if not os.path.isfile(os.path.join(spec.modelfiledir, spec.meshdir, mesh.file))}
    for geom in [geom for geom in spec.geoms if geom.meshname in absent]:
        spec.delete(geom)
    for mesh in [mesh for mesh in spec.meshes if mesh.name in absent]:
        spec.delete(mesh)

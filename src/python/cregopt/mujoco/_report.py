"""What became of a plan."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Optional

import numpy as np

#: A plan is followed if the base is never further from it, m and rad.
FOLLOWED_POSITION, FOLLOWED_ATTITUDE = 0.1, float(np.radians(15.0))


@dataclass
class Report:
    """What a robot made of a plan, from standing before it to standing behind it.

    World frame, SI units, angles rad. The base is the centre of mass with the attitude of the model's first body.

    Attributes
    ----------
    model, mass, planned_mass : str, float, float
        The model's name, its mass, kg, and that of the plan's robot.
    friction, planned_friction : float
        Friction of the ground in the simulation, and the one of the plan.
    seed : int or None
        What start, masses and friction were disturbed by, if at all.
    horizon : float
        How long the plan lasts, s.
    upright, fall_time, fall : bool, float or None, str or None
        Whether the robot stood to the end; else when it fell, s of the plan's time (negative: before it began), and how.
    position_error_max, position_error_rms : float
        Distance of the base from its plan, m.
    attitude_error_max, attitude_error_rms : float
        Angle between the base and its plan, rad.
    end_error : float
        Horizontal distance of the base from the plan's end, where it stands or lies at last, m.
    slip_total, slip_max : float
        How far feet slid while they bore load: all together, and the most in one stance, m.
    missing_contact : float
        Share of the planned stance time in which feet bore nothing.
    torque_share, torque_joint, torque_saturated : float, str, float
        Largest torque as a share of the motors' limits, its joint, and the share of time in which some motor was at its limit.
    joint_speed, joint_speed_limit, speed_joint : float, float, str
        Largest joint speed and the motors' limit, rad/s, and its joint.
    unsolved : int
        Control periods without a solution.
    notes : list of str
        What is odd about model or plan.
    """

    model: str
    mass: float
    planned_mass: float
    friction: float
    planned_friction: float
    seed: Optional[int]
    horizon: float
    upright: bool = True
    fall_time: Optional[float] = None
    fall: Optional[str] = None
    position_error_max: float = 0.0
    position_error_rms: float = 0.0
    attitude_error_max: float = 0.0
    attitude_error_rms: float = 0.0
    end_error: float = 0.0
    slip_total: float = 0.0
    slip_max: float = 0.0
    missing_contact: float = 0.0
    torque_share: float = 0.0
    torque_joint: str = ""
    torque_saturated: float = 0.0
    joint_speed: float = 0.0
    joint_speed_limit: float = 0.0
    speed_joint: str = ""
    unsolved: int = 0
    notes: list[str] = field(default_factory=list)

    @property
    def followed(self) -> bool:
        """Whether the robot stood and its base was never more than 0.1 m and 15 degrees off the plan."""
        return self.upright and self.position_error_max <= FOLLOWED_POSITION and self.attitude_error_max <= FOLLOWED_ATTITUDE

    def to_dict(self) -> dict[str, Any]:
        """Everything, for JSON."""
        return {**asdict(self), "followed": self.followed}

    def __str__(self) -> str:
        if not self.upright:
            end = f"falls at {self.fall_time:.2f} s: {self.fall}"
        elif self.followed:
            end = "upright to the end, on its plan"
        else:
            end = "upright to the end, off its plan"
        disturbed = "" if self.seed is None else f", disturbed by seed {self.seed}"
        lines = [
            f"{self.model}: {end}",
            f"  plan      {self.horizon:.2f} s, {self.planned_mass:.2f} kg, friction {self.planned_friction:g}",
            f"  played    {self.mass:.2f} kg, friction {self.friction:.3g}{disturbed}",
            f"  base      off by at most {self.position_error_max:.3f} m and {np.degrees(self.attitude_error_max):.1f} deg, "
            f"rms {self.position_error_rms:.3f} m and {np.degrees(self.attitude_error_rms):.1f} deg; {self.end_error:.3f} m from its end at last",
            f"  feet      slide at most {self.slip_max:.3f} m in a stance, {self.slip_total:.2f} m in all; "
            f"no contact in {100 * self.missing_contact:.0f} % of stances",
            f"  torque    at most {100 * self.torque_share:.0f} % of the limit ({self.torque_joint}), "
            f"at a limit {100 * self.torque_saturated:.1f} % of the time",
            f"  speed     at most {self.joint_speed:.1f} of {self.joint_speed_limit:g} rad/s ({self.speed_joint})",
        ]
        if self.unsolved:
            lines.append(f"  control   no solution in {self.unsolved} periods")
        return "\n".join(lines + [f"  note      {note}" for note in self.notes])

"""Result of playing a plan."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Optional

import numpy as np

#: Largest position error, m, and attitude error, rad, of the base with which a plan counts as followed.
FOLLOWED_POSITION, FOLLOWED_ATTITUDE = 0.1, float(np.radians(15.0))


@dataclass
class Report:
    """Result of playing a plan, including the standing before and after it.

    World frame, SI units, angles in rad. The base is the centre of mass with the attitude of the model's first body.

    Attributes
    ----------
    model, mass, planned_mass : str, float, float
        Name of the model, its mass, kg, and the mass of the plan's robot, kg.
    friction, planned_friction : float
        Friction coefficients of the ground in the simulation and in the plan.
    seed : int or None
        Seed of the disturbances of start, masses and friction, or None if there were no disturbances.
    horizon : float
        Duration of the plan, s.
    upright, fall_time, fall : bool, float or None, str or None
        True if the robot did not fall; otherwise the time of the fall in the plan's time, s (negative: before the plan started), and its description.
    position_error_max, position_error_rms : float
        Distance of the base from the plan, m.
    attitude_error_max, attitude_error_rms : float
        Angle between the attitudes of the base and the plan, rad.
    end_error : float
        Horizontal distance of the base from the end of the plan, in the last state, m.
    slip_total, slip_max : float
        Distances that loaded feet slid: sum over all stances, and largest of a stance, m.
    missing_contact : float
        Share of the planned stance time in which the feet carried no load.
    torque_share, torque_joint, torque_saturated : float, str, float
        Largest torque as a share of the motor's limit, its joint, and share of time in which at least one motor was saturated.
    joint_speed, joint_speed_limit, speed_joint : float, float, str
        Largest joint speed, rad/s, speed limit of the motors, rad/s, and joint with the largest speed.
    unsolved : int
        Number of control periods in which the quadratic program had no solution.
    notes : list of str
        Remarks on the model or the plan.
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
        """True if the robot did not fall, and its base was never more than 0.1 m or 15 degrees off the plan."""
        return self.upright and self.position_error_max <= FOLLOWED_POSITION and self.attitude_error_max <= FOLLOWED_ATTITUDE

    def to_dict(self) -> dict[str, Any]:
        """All attributes and ``followed``, for JSON."""
        return {**asdict(self), "followed": self.followed}

    def __str__(self) -> str:
        if not self.upright:
            end = f"falls at {self.fall_time:.2f} s: {self.fall}"
        elif self.followed:
            end = "upright to the end, on the plan"
        else:
            end = "upright to the end, off the plan"
        disturbed = "" if self.seed is None else f", disturbed by seed {self.seed}"
        lines = [
            f"{self.model}: {end}",
            f"  plan      {self.horizon:.2f} s, {self.planned_mass:.2f} kg, friction {self.planned_friction:g}",
            f"  played    {self.mass:.2f} kg, friction {self.friction:.3g}{disturbed}",
            f"  base      off by at most {self.position_error_max:.3f} m and {np.degrees(self.attitude_error_max):.1f} deg, "
            f"rms {self.position_error_rms:.3f} m and {np.degrees(self.attitude_error_rms):.1f} deg; ends {self.end_error:.3f} m from the end of the plan",
            f"  feet      slide at most {self.slip_max:.3f} m in a stance, {self.slip_total:.2f} m in total; "
            f"no contact in {100 * self.missing_contact:.0f} % of stances",
            f"  torque    at most {100 * self.torque_share:.0f} % of the limit ({self.torque_joint}), "
            f"at a limit {100 * self.torque_saturated:.1f} % of the time",
            f"  speed     at most {self.joint_speed:.1f} of {self.joint_speed_limit:g} rad/s ({self.speed_joint})",
        ]
        if self.unsolved:
            lines.append(f"  control   no solution in {self.unsolved} periods")
        return "\n".join(lines + [f"  note      {note}" for note in self.notes])

"""Effects and their parameters in words and units that people use.

An effect that is not listed here, a third party's for instance, is shown under its registered
name with the units that the diagnosis reports.
"""

import dataclasses
import math

DEGREES = 180.0 / math.pi


@dataclasses.dataclass(frozen=True)
class EffectWords:
    """How to speak of an effect."""

    label: str
    """Short name."""
    noun: str
    """What is there if the effect is, with its article."""
    physics: str
    """One sentence on what it does."""
    more: str = ""
    """The effect by the size of its only parameter, `{}`; `{base}` is "believed" or "before"."""
    less: str = ""
    """The same where the parameter is negative, with its size."""


@dataclasses.dataclass(frozen=True)
class ParameterWords:
    """How to speak of a parameter."""

    label: str
    """Short name."""
    factor: float = 1.0
    """What a value in SI is multiplied by."""
    unit: str = ""
    """Unit after that; empty for the one that the diagnosis reports."""


EFFECTS = {
    "mass": EffectWords(
        "mass",
        "another mass",
        "The drone is heavier or lighter than the simulator believes.",
        "{} more mass than {base}",
        "{} less mass than {base}",
    ),
    "thrust_gain": EffectWords(
        "thrust gain",
        "another thrust gain",
        "The rotors make more or less thrust than commanded, by a constant factor.",
        "{} more thrust at the same command than {base}",
        "{} less thrust at the same command than {base}",
    ),
    "inertia": EffectWords(
        "inertia",
        "another inertia",
        "The drone resists rotation more or less than the simulator believes.",
        "{} more inertia than {base}",
        "{} less inertia than {base}",
    ),
    "motor_lag": EffectWords(
        "motor lag",
        "another motor lag",
        "The rotors change speed more slowly or quickly than the simulator believes.",
        "rotor time constants {} times as long as {base}",
    ),
    "center_of_mass": EffectWords(
        "centre of mass",
        "a centre of mass off the middle",
        "The centre of mass is off the middle, so that thrust tilts the drone.",
    ),
    "battery": EffectWords(
        "battery",
        "a fading battery",
        "Thrust at the same command fades in the course of the flight.",
        "thrust that fades by {}",
        "thrust that grows by {}",
    ),
    "voltage_sag": EffectWords(
        "voltage sag",
        "a battery that is not compensated for",
        "Thrust at the same command falls with the battery's voltage.",
        "thrust that falls with the battery's voltage by {}",
        "thrust that grows as the battery's voltage falls, by {}",
    ),
    "drag": EffectWords(
        "linear drag",
        "another linear air drag",
        "Air brakes the drone in proportion to its speed, more or less than in the simulator.",
        "{} more linear air drag than {base}",
        "{} less linear air drag than {base}",
    ),
    "quadratic_drag": EffectWords(
        "quadratic drag",
        "another quadratic air drag",
        "Air brakes the drone in proportion to its speed squared.",
        "{} more quadratic air drag than {base}",
        "{} less quadratic air drag than {base}",
    ),
    "rotor_drag": EffectWords(
        "rotor drag",
        "another drag of the rotors",
        "Turning rotors brake the drone in proportion to their speed and to its own.",
    ),
    "translational_lift": EffectWords(
        "translational lift",
        "another translational lift",
        "Flying forward adds thrust, in proportion to the speed across the rotor axis squared.",
        "{} more translational lift than {base}",
        "{} less translational lift than {base}",
    ),
    "roll_pitch_gains": EffectWords(
        "roll and pitch gains",
        "other gains of the roll and pitch loop",
        "The autopilot holds roll and pitch more or less firmly than the simulated one.",
    ),
    "yaw_gains": EffectWords(
        "yaw gains",
        "other gains of the yaw loop",
        "The autopilot holds the heading more or less firmly than the simulated one.",
    ),
    "rotor_inertia": EffectWords(
        "rotor inertia",
        "another inertia of the rotors",
        "Rotors that speed up turn the drone the other way, more or less than in the simulator.",
        "{} more rotor inertia than {base}",
        "{} less rotor inertia than {base}",
    ),
    "gyro_compensation": EffectWords(
        "gyro compensation",
        "an autopilot that cancels gyroscopic torques",
        "Rolling while yawing does not pitch the drone as far as in the simulator.",
    ),
    "rotor_arm": EffectWords(
        "rotor arm",
        "rotors nearer or further out",
        "Thrusts that differ turn the drone more or less than in the simulator.",
    ),
    "rotor_torque": EffectWords(
        "rotor torque",
        "propellers of another drag",
        "The rotors' torque for a given thrust is not the simulated one.",
    ),
    "rotor_response": EffectWords(
        "rotor response",
        "rotors that follow their commands by another law",
        "Rotors slow down more slowly or faster than they speed up, in another proportion than the "
        "simulated ones.",
    ),
    "wind": EffectWords(
        "wind",
        "a steady wind push",
        "A steady push of the air in a fixed direction of the world.",
    ),
    "gust": EffectWords(
        "gust",
        "a wind push that sets in during the flight",
        "A push of the air in a fixed direction of the world, from a certain moment on.",
    ),
    "ground_effect": EffectWords(
        "ground effect",
        "a ground effect",
        "The rotors make more thrust close to the ground.",
        "a ground effect of strength {}",
        "a negative ground effect of strength {}",
    ),
    "downwash": EffectWords(
        "downwash",
        "a downwash below other drones",
        "The air of a drone overhead pushes the one below down.",
    ),
    "attitude_lag": EffectWords(
        "attitude lag",
        "an attitude lag",
        "The drone follows attitude commands later than the simulator believes.",
        "an attitude that follows its commands with {} more lag than {base}",
    ),
    "attitude_gain": EffectWords(
        "attitude gain",
        "another attitude gain",
        "The drone tilts more or less than commanded, by a constant factor.",
        "roll and pitch that come out {} larger than {base}",
        "roll and pitch that come out {} smaller than {base}",
    ),
    "trim": EffectWords(
        "trim",
        "a trim error",
        "The drone leans by a constant angle where level flight is commanded.",
    ),
    "yaw_misalignment": EffectWords(
        "yaw misalignment",
        "a yaw misalignment",
        "The drone's forward axis is turned against the one that the logs assume.",
        "a yaw misalignment of {}",
        "a yaw misalignment of -{}",
    ),
    "delay": EffectWords(
        "delay",
        "a command delay",
        "Commands take effect a fixed time later than the simulator believes.",
        "commands that take effect {} later than {base}",
        "commands that take effect {} earlier than {base}",
    ),
    "attitude_loop": EffectWords(
        "attitude loop",
        "an attitude loop of second order",
        "The drone follows attitude commands like a damped oscillator.",
    ),
    "thrust_lag": EffectWords(
        "thrust lag",
        "a thrust lag",
        "Thrust follows its command with a lag, as rotors need time to change speed.",
    ),
    "floor": EffectWords(
        "floor",
        "a floor",
        "The ground stops the drone at a certain height.",
        "a floor at a height of {}",
        "a floor at a height of -{}",
    ),
}
"""By registered name."""

PARAMETERS = {
    ("mass", "e"): ParameterWords("relative change", 100.0, "%"),
    ("thrust_gain", "e"): ParameterWords("relative change", 100.0, "%"),
    ("inertia", "e"): ParameterWords("relative change", 100.0, "%"),
    ("motor_lag", "scale"): ParameterWords("time constants, times nominal"),
    ("gyro_compensation", "share"): ParameterWords("share that is cancelled", 100.0, "%"),
    ("rotor_arm", "e"): ParameterWords("relative change", 100.0, "%"),
    ("rotor_torque", "e"): ParameterWords("relative change", 100.0, "%"),
    ("rotor_response", "slowing"): ParameterWords("time constant of slowing down, times nominal"),
    ("rotor_response", "quadratic"): ParameterWords("quadratic part of the lag, times nominal"),
    ("center_of_mass", "x"): ParameterWords("forward", 1000.0, "mm"),
    ("center_of_mass", "y"): ParameterWords("to the left", 1000.0, "mm"),
    ("battery", "rate"): ParameterWords("thrust lost", 6000.0, "% a minute"),
    ("voltage_sag", "k"): ParameterWords("thrust lost", 100.0, "% a volt"),
    ("drag", "c"): ParameterWords("coefficient c"),
    ("quadratic_drag", "k"): ParameterWords("coefficient k"),
    ("rotor_drag", "axial"): ParameterWords("along the rotor axis"),
    ("rotor_drag", "lateral"): ParameterWords("across it"),
    ("translational_lift", "k"): ParameterWords("coefficient k"),
    ("rotor_inertia", "e"): ParameterWords("relative change", 100.0, "%"),
    ("roll_pitch_gains", "stiffness"): ParameterWords("gain on the angle", 100.0, "%"),
    ("roll_pitch_gains", "damping"): ParameterWords("gain on the rate", 100.0, "%"),
    ("roll_pitch_gains", "acceleration"): ParameterWords("gain on the acceleration", 100.0, "%"),
    ("roll_pitch_gains", "roll"): ParameterWords("roll over pitch", 100.0, "%"),
    ("yaw_gains", "stiffness"): ParameterWords("gain on the angle", 100.0, "%"),
    ("yaw_gains", "integral"): ParameterWords("gain on its integral", 100.0, "%"),
    ("yaw_gains", "damping"): ParameterWords("gain on the rate", 100.0, "%"),
    ("wind", "x"): ParameterWords("x"),
    ("wind", "y"): ParameterWords("y"),
    ("wind", "z"): ParameterWords("z"),
    ("gust", "x"): ParameterWords("x"),
    ("gust", "y"): ParameterWords("y"),
    ("gust", "z"): ParameterWords("z"),
    ("ground_effect", "c"): ParameterWords("strength c"),
    ("downwash", "width"): ParameterWords("width", 1000.0, "mm"),
    ("attitude_lag", "tau"): ParameterWords("time constant", 1000.0, "ms"),
    ("attitude_gain", "g"): ParameterWords("relative change", 100.0, "%"),
    ("trim", "roll"): ParameterWords("roll", DEGREES, "°"),
    ("trim", "pitch"): ParameterWords("pitch", DEGREES, "°"),
    ("yaw_misalignment", "angle"): ParameterWords("angle", DEGREES, "°"),
    ("delay", "seconds"): ParameterWords("delay", 1000.0, "ms"),
    ("attitude_loop", "natural_freq"): ParameterWords("natural frequency"),
    ("thrust_lag", "up"): ParameterWords("time constant, rising", 1000.0, "ms"),
    ("thrust_lag", "down"): ParameterWords("time constant, falling", 1000.0, "ms"),
}
"""By registered names of effect and parameter."""


def effect_words(name: str) -> EffectWords:
    """How to speak of the effect that is registered as `name`."""
    plain = name.replace("_", " ")
    return EFFECTS.get(name) or EffectWords(plain, f"the effect {plain}", "")


def parameter_words(effect: str, name: str) -> ParameterWords:
    """How to speak of a parameter of an effect."""
    return PARAMETERS.get((effect, name)) or ParameterWords(name.replace("_", " "))

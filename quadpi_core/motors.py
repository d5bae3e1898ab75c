# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What is known of the motors of a vehicle whose rotor speeds follow from commands.

    n = c · (1, u, u², V, u V),      followed by a first-order lag and a dead time,

of each rotor; :mod:`quadpi_core.speeds_by_command` makes speeds of it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Annotated, Any

from quadpi_core.config_schema import Positive, Real, Section, Within
from quadpi_core.thresholds import Threshold

TERMS = 5
LAG_MAX_S, DEAD_MAX_S = 0.5, 0.1
HALF_READING = Threshold(
    "speed of a rotor over that of the others at the same command from which its tachometer counts otherwise",
    (0.6, 1.6),
    "",
    "counting every second pulse, or one twice, gives 0.5 or 2; rotors of one vehicle differ by up to 15 %",
    "eckart51 to 54 of imrc_payload in ../shared/data read 0.502",
)
SILENT_SHARE = Threshold(
    "speed of a rotor over that of the others at the same command below which it stands, or is not told",
    0.1,
    "",
    "idling rotors turn at a fifth of the speed of hover, and tachometers that miscount at half",
    "eckart51 to 54 of imrc_payload in ../shared/data read 0.502",
)
USUAL_GAIN = Threshold(
    "standard deviation from flight to flight of one gain of all rotor speeds from commands",
    0.02,
    "",
    "air and battery change thrust by up to 7.6 % at the same command and voltage, speed by half of that",
    "of motors whose flights do not tell it; imrc_brushed of ../shared/data",
)


@dataclass(frozen=True, kw_only=True)
class Motors(Section):
    """The key `motors` of a vehicle file: flights of a vehicle that has it are read by their commands.

    Attributes:
        source: whose commands, as adapters and log formats name them: others have another scale.
        coefficients: of 1, u, u², V and u V, for each rotor, rad/s.
        lag_s: time constant of the first order.
        dead_s: dead time before it.
        volts: battery voltage until a message tells it; those of V are 0 where it is not used.
        error: root mean square of what is left, over the mean speed, by rotor, on flights left out; empty
            where no flight had rotor speeds, and their scale is that of hover thrust.
        gain: standard deviation from flight to flight of one gain of all speeds.
    """

    source: str
    coefficients: tuple[tuple[Real, ...], ...]
    lag_s: Annotated[float, Within(0.0, LAG_MAX_S)]
    dead_s: Annotated[float, Within(0.0, DEAD_MAX_S)] = 0.0
    volts: Positive = 1.0
    error: tuple[Real, ...] = ()
    gain: Annotated[float, Within(0.0, 1.0)] = USUAL_GAIN.value

    def __post_init__(self) -> None:
        """Refuse another number of coefficients.

        Raises:
            ValueError: naming the key.
        """
        if not self.coefficients or any(len(own) != TERMS for own in self.coefficients):
            raise ValueError(f"`coefficients` must list {TERMS} numbers for each rotor")

    def to_file(self) -> dict[str, Any]:
        """Content of the key."""
        lists = {"coefficients": [list(own) for own in self.coefficients], "error": list(self.error)}
        return {**asdict(self), **lists}

    @property
    def with_battery(self) -> bool:
        """Whether voltage is in it."""
        return any(own[3] or own[4] for own in self.coefficients)

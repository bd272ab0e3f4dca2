# SPDX-License-Identifier: Apache-2.0
"""Options of the input, a part of `config`: how images are read, and how they are paired."""

from __future__ import annotations

from dataclasses import dataclass

from binocular_recon.errors import ConfigError
from binocular_recon.options import Options, option


@dataclass(frozen=True)
class ImageConfig(Options):
    """Options of how the values of images are read."""

    white_level: float = option(
        0.0,
        'White of 16-bit and floating-point images, such as 4095 for 12 bits; 0: found from the'
        ' images, the same for all frames; 8-bit images have 255',
        minimum=0.0,
        maximum=1e6,
    )
    black_level: float = option(
        0.0, 'With white_level: black of these images', minimum=-1e6, maximum=1e6
    )

    def __post_init__(self) -> None:
        """Check that black and white belong together."""
        super().__post_init__()
        if self.black_level and self.black_level >= self.white_level:
            raise ConfigError(
                f'black_level must be below white_level, got {self.black_level:g} and'
                f' {self.white_level:g}; set both'
            )


# What decides which messages belong together.
PAIRINGS = ('stamps', 'arrival')


@dataclass(frozen=True)
class PairingOptions(Options):
    """Options of which images of the cameras belong together."""

    pairing: str = option(
        'stamps',
        'What tells that messages belong together: their stamps, or that they arrive together'
        ' (for cameras on one hardware trigger whose stamps are of no use)',
        choices=PAIRINGS,
    )
    stamp_offset: float = option(
        0.0,
        "Added to the stamps of the right camera's messages, for a clock that differs by a"
        ' constant; outputs keep the stamps of the left camera',
        unit='s',
        minimum=-1e10,
        maximum=1e10,
    )

    @property
    def by_arrival(self) -> bool:
        """Whether arrival, not stamps, tells what belongs together."""
        return self.pairing == 'arrival'

    @property
    def stamp_offset_ns(self) -> int:
        """Added to the stamps of the right camera, ns."""
        return round(self.stamp_offset * 1e9)

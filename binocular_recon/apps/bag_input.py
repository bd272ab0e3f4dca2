# SPDX-License-Identifier: Apache-2.0
"""The pairs of a bag."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from binocular_recon.apps.earlier_run import fingerprint
from binocular_recon.apps.pair_input import OpenInput, PairInput
from binocular_recon.errors import BagError
from binocular_recon.io.bags.reader import Bag
from binocular_recon.io.bags.stereo_bag import StereoBag
from binocular_recon.io.bags.stereo_topics import (
    StereoTopics,
    find_stereo_topics,
    name_stereo_topics,
)
from binocular_recon.io.calibration_yaml import read_rig


@dataclass(frozen=True)
class BagInput(PairInput):
    """A bag and the pairs of it that are reconstructed.

    Attributes
    ----------
    bag : Path
    namespace : str, optional
        Namespace of the rig.
    images, infos : (str, str), optional
        Topics of left and right if they do not have the usual names.

    Notes
    -----
    The calibration, if there is one, replaces the recorded camera infos.

    """

    bag: Path
    namespace: str | None = None
    images: tuple[str, str] | None = None
    infos: tuple[str, str] | None = None

    @contextmanager
    def open(self) -> Iterator[OpenInput]:
        """Open the bag.

        Raises
        ------
        BagError
            If it is not a bag, or does not hold what is named.
        BinocularReconError
            If the calibration cannot be used.

        """
        with Bag(self.bag) as bag:
            topics = self._topics(bag)
            rig = (
                read_rig(self.calibration, rectified=topics.rectified)
                if self.calibration
                else None
            )
            pairs = StereoBag(
                bag, topics, rig, tolerance_ns=self.tolerance_ns, pairing=self.pairing
            )
            versions = {'rosbags': version('rosbags')}
            facts = {
                **self.facts(),
                **topics._asdict(),
                'bag': str(self.bag),
                'files': fingerprint(self.bag),
            }
            yield OpenInput(pairs, topics.rectified, facts, versions, [], BagError)

    def _topics(self, bag: Bag) -> StereoTopics:
        calibrated = self.calibration is not None
        if self.images is None:
            return find_stereo_topics(bag.topics, self.namespace, calibrated=calibrated)
        return name_stereo_topics(
            bag.topics,
            self.images,
            self.infos,
            rectified=self.rectified,
            calibrated=calibrated,
        )

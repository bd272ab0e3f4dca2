# SPDX-License-Identifier: Apache-2.0
"""Messages of ROS 1 bags, serialised as in ROS 2."""

from __future__ import annotations

from rosbags.convert.converter import is_same_wireformat, migrate_bytes
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore


class Ros1Conversion:
    """Convert the serialised messages of one ROS 1 bag.

    Parameters
    ----------
    definitions : dict of str to str
        Message definitions of the bag by type, with those of their members.
    ros2 : Typestore
        Types of ROS 2; types that it lacks are added as the bag defines them.

    """

    def __init__(self, definitions: dict[str, str], ros2: Typestore) -> None:
        self._definitions = definitions
        self._ros1: dict[str, Typestore] = {}
        self._ros2 = ros2
        self._defaults: dict[str, object] = {}

    def __call__(self, msgtype: str, data: bytes) -> bytes:
        """Return a message of type ``msgtype`` in CDR.

        If the members of its type changed from ROS 1 to ROS 2, it is converted member by member.
        """
        if msgtype not in self._ros1:
            self._register(msgtype)
        ros1 = self._ros1[msgtype]
        if is_same_wireformat(ros1, self._ros2, msgtype, msgtype):
            return bytes(self._ros2.ros1_to_cdr(data, msgtype))
        return bytes(
            migrate_bytes(
                ros1,
                self._ros2,
                msgtype,
                msgtype,
                self._defaults,
                data,
                src_is2=False,
                dst_is2=True,
            )
        )

    def _register(self, msgtype: str) -> None:
        types = get_types_from_msg(self._definitions[msgtype], msgtype)
        ros1 = get_typestore(Stores.EMPTY)
        ros1.register(types)
        self._ros1[msgtype] = ros1
        self._ros2.register(
            {name: fields for name, fields in types.items() if name not in self._ros2.fielddefs}
        )

# SPDX-License-Identifier: Apache-2.0
"""Messages of ROS 1 bags, serialised as in ROS 2."""

from __future__ import annotations

from typing import Any

from rosbags.convert.converter import is_same_wireformat, migrate_bytes
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from binocular_recon.errors import BagError

# Most members of a message, those of its members and fixed arrays included.
MOST_MEMBERS = 1_000_000


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
        check_definition(types, msgtype)
        ros1 = get_typestore(Stores.EMPTY)
        ros1.register(types)
        self._ros1[msgtype] = ros1
        self._ros2.register(
            {name: fields for name, fields in types.items() if name not in self._ros2.fielddefs}
        )


def check_definition(types: Typesdict, msgtype: str) -> None:
    """Raise a BagError if a message of a few bytes could have any number of members.

    Parameters
    ----------
    types : dict
        Definitions by type, as rosbags parses them; those that are not in it are known ones.
    msgtype : str
        Type of the message.

    """
    counts: dict[str, int] = {}
    pending: list[str] = []

    def members(name: str) -> int:
        """Return the number of members that every message of a type has, at least 1."""
        if name in pending:
            raise BagError(f'its definition nests {name} in itself')
        if name not in counts:
            pending.append(name)
            fields = types[name][1] if name in types else []
            counts[name] = max(1, sum(members_of(*field) for _, field in fields))
            pending.pop()
        return counts[name]

    def members_of(kind: Nodetype, content: Any) -> int:
        if kind == Nodetype.NAME:
            return members(content)
        if kind == Nodetype.BASE:
            return 1
        (element, name), count = content
        if element == Nodetype.BASE:  # read at once
            return 1
        least = members(name)
        if kind == Nodetype.ARRAY:
            return least * int(count)
        if name in types and not types[name][1]:
            raise BagError(f'its definition has a sequence of {name}, which has no content')
        return 1

    if members(msgtype) > MOST_MEMBERS:
        raise BagError(
            f'its definition has {members(msgtype)} members, at most {MOST_MEMBERS} are read'
        )

# SPDX-License-Identifier: Apache-2.0
"""Kernel that reads through the entropy-coded data of a baseline JPEG."""

from __future__ import annotations

from binocular_recon._jit import Array, kernel

# Entries of the tables by the next 16 bits: length of the code in bits times 256, plus the symbol.
CODE_BITS = 16
_MOST_HELD = 48


@kernel
def count_units(data: Array, tables: Array, blocks: Array, restart: int, units: int) -> int:
    """Return how many of the coded units (MCUs) are complete.

    ``data`` are the bytes of the scan, ``tables`` (8, 65536) the Huffman tables, 0 = no code,
    ``blocks`` (n, 2) the tables of the first and of the other coefficients of each block of a
    unit, ``restart`` the units between restart markers, 0 = none.
    """
    position, stop = 0, data.size - 1  # a marker ends the scan
    bits, held = 0, 0
    for unit in range(units):
        if restart > 0 and unit > 0 and unit % restart == 0:
            bits, held = 0, 0
            while position < stop and not (data[position] == 0xFF and data[position + 1] >= 0xD0):
                position += 1
            if position >= stop or data[position + 1] > 0xD7:
                return unit
            position += 2
        for block in range(len(blocks)):
            place = 0
            while place < 64:
                while held <= _MOST_HELD and position < stop:
                    byte = int(data[position])
                    if byte == 0xFF:
                        if data[position + 1] != 0:  # the next marker
                            break
                        position += 1
                    position += 1
                    bits = (bits << 8) | byte
                    held += 8
                peek = (
                    bits >> (held - CODE_BITS) if held >= CODE_BITS else bits << (CODE_BITS - held)
                )
                entry = int(tables[blocks[block, min(place, 1)], peek & 0xFFFF])
                length, symbol = entry >> 8, entry & 0xFF
                if place == 0:
                    size, place = symbol, 1
                elif symbol == 0:  # the rest of the block is zero
                    size, place = 0, 64
                else:
                    size, place = symbol & 15, place + (symbol >> 4) + 1
                held -= length + size
                if length == 0 or held < 0:
                    return unit
                bits &= (1 << held) - 1
    return units

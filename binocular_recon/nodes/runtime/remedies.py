# SPDX-License-Identifier: Apache-2.0
"""What to change so that messages whose stamps differ form frames."""

from __future__ import annotations

from binocular_recon.inputs.clocks import Mismatch


def remedy(missing: Mismatch, tolerance_ns: int | None) -> str:
    """Return the parameters to set so that stamps match, by the tolerance in use."""
    if missing.offset_s is not None:
        beside = ''
        if missing.offset_tolerance_s * 1e9 > (tolerance_ns or 0):
            beside = (
                ' with approximate_sync and approximate_sync_tolerance_seconds of'
                f' {missing.offset_tolerance_s:.6f}'
            )
        exact = (
            f'set stamp_offset to {missing.offset_text}{beside}, or pairing to arrival if a'
            ' hardware trigger takes them together'
        )
        if missing.tolerance_s is None:
            return exact
    if missing.tolerance_s is None:
        return (
            'that is at least half a frame period, so no tolerance tells which belong'
            ' together: trigger the cameras together and stamp them by one clock'
        )
    remedy = (
        'raise approximate_sync_tolerance_seconds to'
        if tolerance_ns
        else 'trigger the cameras together or set approximate_sync with'
        ' approximate_sync_tolerance_seconds of'
    )
    remedy = f'{remedy} at least {missing.tolerance_s:.6f}'
    return f'{remedy}, or {exact}' if missing.offset_s is not None else remedy

# SPDX-License-Identifier: Apache-2.0
"""The page to look at a reconstruction, click and measure.

`picks_board` holds picks and what is measured between them, with undo, in step with the picks
file; `measurer` measures with the session of `apps.survey`. `coloured_frame` is a frame as it is
shown: colours by pixel, the cloud thinned, and which pixel a ray of sight meets. `shared_view` is
what all browsers see and do, `actions` are the messages by which a page asks for something.
`scene` draws the cloud and the measurements with viser, `guard` lets in only those who know the
address, and `page_server` serves all of it on one port of this machine. The folder ``page`` is
what the browser runs.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.viewer.page_server import PageServer
    from binocular_recon.viewer.picks_board import PicksBoard
    from binocular_recon.viewer.shared_view import SharedView

__all__ = ['PageServer', 'PicksBoard', 'SharedView']

__getattr__ = lazy_exports(__name__, __file__)

# SPDX-License-Identifier: Apache-2.0
"""What people look at: heat maps, drawn clouds and detections, charts, the HTML page style.

`colormap` colours disparities, `clouds` draws a point cloud from an oblique view, `detections`
marks what was found in an image, `labels` writes into images, `svg` draws charts and `page` is
the style of every report.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.drawing.clouds import CloudView, draw_cloud
    from binocular_recon.drawing.colormap import heat_map
    from binocular_recon.drawing.detections import draw_detections
    from binocular_recon.drawing.svg import Chart

__all__ = [
    'Chart',
    'CloudView',
    'draw_cloud',
    'draw_detections',
    'heat_map',
]

__getattr__ = lazy_exports(__name__, __file__)

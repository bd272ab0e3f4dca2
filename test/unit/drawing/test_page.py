# SPDX-License-Identifier: Apache-2.0
"""The HTML page of reports: complete without the network, on the screen and on A4."""

from __future__ import annotations

import re

import numpy as np

from binocular_recon.drawing.page import image_figure, page, section, table


def print_rules() -> dict[str, str]:
    """Return the declarations for print of each selector."""
    style = page('title', [])
    rules = re.search(r'@media print \{(.*)\n\}', style, flags=re.DOTALL)
    assert rules
    found: dict[str, str] = {}
    for selectors, body in re.findall(r'([^{}]+)\{([^{}]*)\}', rules[1]):
        for selector in selectors.split(','):
            found[selector.strip()] = found.get(selector.strip(), '') + body
    return found


def test_nothing_is_cut_on_a4() -> None:
    assert '@page { size: A4;' in page('title', [])
    rules = print_rules()
    for whole in ('figure', 'table', 'tr', 'li', 'h2', 'section > p'):
        assert 'break-inside: avoid' in rules[whole], whole
    for title in ('h2', 'section > p'):
        assert 'break-after: avoid' in rules[title], title
    # a table longer than a page goes on under its own header
    assert 'table-header-group' in rules['thead']


def test_wide_tables_wrap_on_paper_instead_of_scrolling() -> None:
    rules = print_rules()
    assert 'overflow: visible' in rules['.scroll']
    assert 'white-space: normal' in rules['.scroll td']
    assert 'white-space: normal' in rules['.scroll th']


def test_keys_to_colours_are_printed() -> None:
    """Browsers leave out backgrounds unless they are told otherwise."""
    assert 'print-color-adjust: exact' in print_rules()['body']


def test_a_page_is_complete_and_its_text_is_not_taken_for_html() -> None:
    image = image_figure(np.zeros((2, 3, 3), np.uint8), 'an <b>image</b>')
    # an image that waits until it is scrolled to would be missing on paper
    assert 'src="data:image/png;base64,' in image and 'loading' not in image
    cells = table(['a < b', 'c'], [['1', '2'], ['3', '4']], marked=[1])
    assert '<th>a &lt; b</th>' in cells
    assert '<tr class="ours"><td>3</td>' in cells
    whole = page('<title>', [section('one & two', 'text', image, cells)], 'the end.')
    assert '<title>&lt;title&gt;</title>' in whole and '<h2>one &amp; two</h2>' in whole
    assert 'the end.</footer>' in whole
    assert not re.search(r'(href|src)="(?!data:)', whole)

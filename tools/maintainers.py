# SPDX-License-Identifier: Apache-2.0
"""Copy MAINTAINERS.md to the files that must repeat it (``make maintainers``)."""

from __future__ import annotations

import json
import re
import runpy
from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

REPOSITORY = Path(__file__).resolve().parents[1]
# The schema of package.xml asks for an address; no mail reaches one under .invalid (RFC 2606).
NO_MAIL = 'maintainers@binocular-recon.invalid'
URL_TYPES = {'documentation': 'website', 'repository': 'repository', 'issues': 'bugtracker'}


def facts() -> dict[str, str]:
    """Return the table of MAINTAINERS.md, as setup.py reads it."""
    table: dict[str, str] = runpy.run_path(str(REPOSITORY / 'setup.py'))['maintainers']()
    return table


def manifest(text: str, facts: Mapping[str, str]) -> str:
    """Return ``package.xml`` with its maintainer and addresses replaced."""
    mail, name = quoteattr(facts['e-mail'] or NO_MAIL), escape(facts['maintainer'])
    urls = ''.join(
        f'  <url type="{kind}">{escape(facts[field])}</url>\n'
        for field, kind in URL_TYPES.items()
        if facts[field]
    )
    text = re.sub(r'  <url .*\n', '', text)
    maintainer = f'<maintainer email={mail}>{name}</maintainer>'
    text = re.sub(r'<maintainer .*</maintainer>', lambda _: maintainer, text)
    return re.sub(r'(?<=</license>\n)', lambda _: urls, text)


def citation(text: str, facts: Mapping[str, str]) -> str:
    """Return ``CITATION.cff`` with its author and addresses replaced."""
    urls = {'repository-code': facts['repository'], 'url': facts['documentation']}
    lines = f'authors:\n  - name: {json.dumps(facts["maintainer"])}\n'
    lines += ''.join(f'{key}: {json.dumps(url)}\n' for key, url in urls.items() if url)
    text = re.sub(r'^(repository-code|url): .*\n', '', text, flags=re.MULTILINE)
    return re.sub(r'^authors:\n(?:  .*\n)+', lambda _: lines, text, flags=re.MULTILINE)


FILES = {'package.xml': manifest, 'CITATION.cff': citation}


def main() -> None:
    """Write the files and name those that changed."""
    table = facts()
    for name, rewrite in FILES.items():
        path = REPOSITORY / name
        old = path.read_text(encoding='utf-8')
        new = rewrite(old, table)
        if new != old:
            path.write_text(new, encoding='utf-8')
            print(f'{name} written')


if __name__ == '__main__':
    main()

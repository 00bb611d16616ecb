# Copyright 2026 tudor_dynamics contributors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Look at pages in a browser: pictures at two widths, light and dark, and what is wrong with them.

    python tools/look.py build/docs demo_out/model/report.html --out looked_at
    python tools/look.py demo_out/model/report.html --top 1100      as pictures of the gallery are

Folders are searched for pages. A page that is wider than its window, loads something from the
network, misses a picture or has an error of a script is named; then the exit code is 1. Pictures
are taken of pages that are named, not of those in folders. Needs a Chromium of the system
(`apt install chromium`) and `pip install playwright`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
import shutil
import sys
from typing import Any

from PIL import Image

WIDTHS, SCHEMES = (1400, 390), ('light', 'dark')  # a desk and a telephone [px]
COLOURS = 48  # of a picture of the top of a page
PATIENCE = 1000  # until plots and formulas are drawn [ms]
WIDE = 'document.documentElement.scrollWidth > window.innerWidth'
MISSING = '[...document.images].filter(i => !i.complete || !i.naturalWidth).map(i => i.src)'


def faults(
    browser: Any, page: Path, width: int, scheme: str, picture: Path | None, top: int,
) -> Iterator[str]:
    """Open a page; give what is wrong with it."""
    context = browser.new_context(
        viewport={'width': width, 'height': 900}, color_scheme=scheme)
    window, found = context.new_page(), list[str]()
    window.on('pageerror', lambda error: found.append(f'error of a script: {error}'))
    window.on('request', lambda request: found.append(f'loads {request.url}')
              if not request.url.startswith(('file:', 'data:', 'blob:')) else None)
    window.goto(page.absolute().as_uri())
    if picture is not None or 'MathJax' in page.read_text(encoding='utf-8'):
        window.wait_for_timeout(PATIENCE)
    if window.evaluate(WIDE):
        found.append('wider than its window')
    found += [f'no picture {name}' for name in window.evaluate(MISSING)]
    if picture is not None:
        part = {'x': 0, 'y': 0, 'width': width, 'height': top}
        window.screenshot(path=picture, full_page=True, **({'clip': part} if top else {}))
        if top:  # few colours are enough for a picture of a page
            Image.open(picture).quantize(COLOURS).save(picture, optimize=True)
    context.close()
    yield from found


def main(argv: Sequence[str] | None = None) -> int:
    """Look at all pages."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('pages', nargs='+', type=Path, metavar='PAGE', help='files or folders')
    parser.add_argument('--out', type=Path, default=Path('looked_at'), help='folder of pictures')
    parser.add_argument('--top', type=int, default=0, metavar='PX',
                        help='of the top of each page alone, in few colours (default: all)')
    args = parser.parse_args(argv)
    from playwright.sync_api import sync_playwright  # not among the dependencies, see above
    args.out.mkdir(parents=True, exist_ok=True)
    count = wrong = 0
    with sync_playwright() as play:
        browser = play.chromium.launch(
            executable_path=shutil.which('chromium'), args=['--no-sandbox', '--disable-gpu'])
        for place in args.pages:
            for page in sorted(place.rglob('*.html')) if place.is_dir() else [place]:
                for width in WIDTHS:
                    for scheme in SCHEMES:
                        picture = None if place.is_dir() else (
                            args.out / f'{page.stem}_{width}_{scheme}.png')
                        for fault in faults(
                                browser, page, width, scheme, picture, args.top):
                            print(f'{page} at {width} px, {scheme}: {fault}')
                            wrong += 1
                count += 1
    print(f'{count} pages, {wrong} faults; pictures in {args.out}')
    return 1 if wrong else 0


if __name__ == '__main__':
    sys.exit(main())

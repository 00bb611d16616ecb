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
Ask the search of the site what newcomers ask, in a browser: is the answer among the first?

    python tools/ask.py build/docs

Needs what `tools/look.py` needs. The exit code is 1 where a question finds its page too late.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import shutil
import sys
from urllib.parse import quote_plus

FIRST = 3  # a reader opens so many
QUESTIONS = {
    'how do I describe a gauge in mV/V?': 'questions.html#a-gauge-in-mv-v',
    'why "do not use"?': 'howto/read_the_verdict.html',
    'do not use': 'howto/read_the_verdict.html',
    'what happens when the network is cut?': 'questions_running.html#what-happens-when-network',
    'how do I damp at 40 ms of delay?': 'howto/damp.html',
    'is my fit good enough': 'howto/read_the_verdict.html',
    'no gauges': 'howto/without_gauges.html',
    'robot vibrates when it stops': 'howto/my_arm_rings.html',
    'payload kilograms': 'howto/payload.html',
    'learn thresholds another day': 'questions_running.html#learn-thresholds-again',
    'can I use my arm without urdf': 'questions.html#i-have-no-urdf',
    'false alarms': 'questions_running.html#why-did-my-arm-stop',
    'two arms on one computer': 'questions_running.html#can-i-run-two-arms',
    'report a bug': 'howto/report_a_bug.html'}
"""Each question with the page that answers it."""
FOUND = '#search-results ul.search li > a'
DONE = "/found|did not match/.test(document.querySelector('#search-results').innerText)"


def main(argv: Sequence[str] | None = None) -> int:
    """Ask all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('site', type=Path, metavar='DIR', help='folder of `make docs`')
    args = parser.parse_args(argv)
    from playwright.sync_api import sync_playwright  # not among the dependencies, see above
    search, late = (args.site / 'search.html').absolute().as_uri(), 0
    with sync_playwright() as play:
        window = play.chromium.launch(
            executable_path=shutil.which('chromium'), args=['--no-sandbox', '--disable-gpu']
        ).new_page()
        for question, answer in QUESTIONS.items():
            window.goto(f'{search}?q={quote_plus(question)}')
            window.wait_for_function(DONE)
            links = window.eval_on_selector_all(FOUND, 'all => all.map(one => one.href)')
            place = next((number for number, link in enumerate(links, start=1)
                          if answer in link), 0)
            late += not 0 < place <= FIRST
            print(f'{place or "absent":>6}  {question}')
    print(f'{len(QUESTIONS)} questions, {late} without an answer among the first {FIRST}')
    return 1 if late else 0


if __name__ == '__main__':
    sys.exit(main())

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
Take the pictures of the documentation from the figures of ``python -m papers figures --out DIR``.

    python tools/docs_pictures.py DIR
"""

from __future__ import annotations

from pathlib import Path
import sys

from PIL import Image

PICTURES = {'malzahn_2_damping': 'damping', 'malzahn_6_strain': 'strain',
            'own_damping': 'payloads', 'own_collisions': 'collisions'}
COLOURS = 48
DOCS = Path(__file__).resolve().parents[1] / 'docs' / 'pictures'


def main() -> None:
    """Write them with few colours, which is all they have: a third of the size."""
    for name, own in PICTURES.items():
        with Image.open(Path(sys.argv[1]) / f'{name}.png') as picture:
            small = picture.convert('RGB').quantize(COLOURS, dither=Image.Dither.NONE)
            small.save(DOCS / f'{own}.png', optimize=True)


if __name__ == '__main__':
    main()

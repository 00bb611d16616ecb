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

"""Pages in plain words: spelling, the word list of CONTRIBUTING, length, reading ease."""

from __future__ import annotations

import ast
from pathlib import Path
import re
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'tools'))

from messages import messages  # noqa: E402, I100

DOCS = ROOT / 'docs'
EASY = sorted([*(DOCS / 'tutorials').glob('*.md'), *(DOCS / 'howto').glob('*.md')])
PAGES = sorted([ROOT / 'README.md', DOCS / 'index.md', *EASY, *(DOCS / 'explanation').glob('*.md'),
                DOCS / 'gallery.md', DOCS / 'reference' / 'index.md',
                DOCS / 'reference' / 'nodes.md', DOCS / 'reference' / 'trajectories.md',
                *(DOCS / 'reference' / 'nodes').glob('*.md')])
"""Pages in the words of the glossary; a page that is written again joins them."""
WHOLE = [*PAGES, DOCS / 'architecture.md', DOCS / 'reference' / 'arm_yaml.md',
         DOCS / 'reference' / 'causes.md', ROOT / 'CONTRIBUTING.md',
         ROOT / 'QUALITY_DECLARATION.md', ROOT / 'bags' / 'README.md',
         ROOT / 'examples' / 'README.md', ROOT / '.github/ISSUE_TEMPLATE/bug_report.md']
"""Those and all other pages that people write."""
PHRASES = (r'\bwhat came\b', r'(?<!there )(?<!that )\bis none\b', r'\bno matter\b', r'\bworth\b',
           r'\bbehind\b', r'\btells?\b', r'\btold\b', r'\bfeels?\b', r'\bfelt\b', r'\bswings?\b',
           r'\banew\b', r'\bodd\b', r'\bcomes? to rest\b', r'\bbeyond reason\b', r'\ball but \d')
"""Phrases that the glossary replaces; single words stand in ``tools/words.txt``."""
SAID = (*PHRASES, r'\bwants?\b', r'\bcomes out\b', r'\bwhat is left\b', r'\bnothing pays\b',
        r'\bunlike\b')
"""Those and what they lead to, in messages."""
LONGEST_SENTENCE = 30
LONGEST = 400
ALL_GUIDES = 25000
BY_HAND = 4000
"""Words of the guides, and of the pages of nodes without what a script writes."""
OUTPUT = re.compile(r'^```text.*?^```$', re.MULTILINE | re.DOTALL)
WRITTEN = re.compile(r'<!-- written by .*?<!-- end -->', re.DOTALL)
EASIEST = 55.0
TAGS = re.compile(r'\{[%#{].*?[%#}]\}|<script.*?</script>|<style.*?</style>|<[^>]*>', re.DOTALL)
"""What people do not see of a template."""


def prose(page: Path) -> str:
    """Give the sentences of a page: no blocks, tables, headings; code and formulas are a word."""
    text = re.sub(r'^ *(```|~~~).*?^ *\1 *$', '', page.read_text(encoding='utf-8'),
                  flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r'<!--.*?-->|\$\$.*?\$\$', '', text, flags=re.DOTALL)
    text = re.sub(r'\$[^$]+\$', 'symbol', text)
    text = '\n'.join('' if line.lstrip().startswith(('|', '#', '!', ':')) else line
                     for line in text.splitlines())
    text = re.sub(r'\]\([^)]*\)', '', text)
    text = re.sub(r'`[^`]*`', 'name', text)
    text = re.sub(r'^ *(?:\d+\.|\*) ', '\n', text, flags=re.MULTILINE)
    return re.sub(r'[\[\]*_]', '', text)


def docstrings(path: Path) -> list[tuple[str, str]]:
    """Give name and text of the docstrings of a module, those of attributes included."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if not isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
            continue
        found += [(getattr(node, 'name', 'module'), item.value.value) for item in node.body
                  if isinstance(item, ast.Expr) and isinstance(item.value, ast.Constant)
                  and isinstance(item.value.value, str)]
    return found


def kept(page: Path) -> str:
    """Give a page without the words that the glossary of CONTRIBUTING names to be left out."""
    text = page.read_text(encoding='utf-8')
    return text if page.name != 'CONTRIBUTING.md' else re.sub(
        r'^(\|.*\|.*\|).*\|$', r'\1', text, flags=re.MULTILINE)


def worded(page: Path) -> str:
    """Give the words of a page, those of tables and headings too, in one line."""
    marked = '\n'.join(re.sub(r'`[^`]*`', 'name', line) for line in kept(page).splitlines()
                       if line.lstrip().startswith(('|', '#')))
    return re.sub(r'\s+', ' ', f'{prose(page)} {marked}')


def sentences(text: str) -> list[list[str]]:
    """Split prose into sentences, and these into words."""
    parts = re.split(r'[.!?](?:\s|$)|\n\s*\n', text)
    return [words for words in (re.findall(r"[A-Za-z']+", part) for part in parts) if words]


def syllables(word: str) -> int:
    """Count groups of vowels, without a mute e at the end."""
    word = word.lower()
    groups = len(re.findall(r'[aeiouy]+', word))
    return max(groups - (word.endswith('e') and not word.endswith('le')), 1)


def count(text: str) -> int:
    """Count words, those of tables, formulas and code included; marks are none."""
    return len(re.findall(r'\S*\w\S*', text))


def flesch(text: str) -> float:
    """Give Flesch's reading ease: 206.8 - 1.015 words a sentence - 84.6 syllables a word."""
    found = sentences(text)
    words = [word for sentence in found for word in sentence]
    return (206.835 - 1.015 * len(words) / len(found)
            - 84.6 * sum(map(syllables, words)) / len(words))


def test_the_formula() -> None:
    """Short words in short sentences read easily, long ones do not."""
    assert flesch('The cat sat on the mat. The dog ran.') > 100.0
    assert flesch('Identification necessitates considerable theoretical sophistication.') < 0.0


@pytest.mark.linter
@pytest.mark.parametrize('page', EASY, ids=[page.stem for page in EASY])
def test_guides_are_short_and_read_easily(page: Path) -> None:
    """A how-to or tutorial has a reading ease above 55; a how-to has 400 words at most."""
    text = prose(page)
    if len(text.split()) > 40:
        assert flesch(text) > EASIEST
    if page.parent.name == 'howto':
        assert len(page.read_text(encoding='utf-8').split()) <= LONGEST


@pytest.mark.linter
def test_all_guides_together_are_short() -> None:
    """Tutorials without what commands print, how-to, explanation, architecture; then nodes."""
    pages = [*EASY, *(DOCS / 'explanation').glob('*.md'), DOCS / 'architecture.md']
    words = {}
    for page in pages:
        text = page.read_text(encoding='utf-8')
        words[str(page.relative_to(DOCS))] = count(
            OUTPUT.sub('', text) if page.parent.name == 'tutorials' else text)
    assert sum(words.values()) <= ALL_GUIDES, words
    nodes = [DOCS / 'reference' / 'nodes.md', *(DOCS / 'reference' / 'nodes').glob('*.md')]
    assert sum(count(page.read_text(encoding='utf-8')) for page in nodes) <= BY_HAND


@pytest.mark.linter
@pytest.mark.parametrize('page', WHOLE, ids=[page.stem for page in WHOLE])
def test_words_of_the_glossary(page: Path) -> None:
    """No phrase that the glossary replaces."""
    text = worded(page)
    found = [match[0] for phrase in PHRASES for match in re.finditer(phrase, text)]
    assert not found


@pytest.mark.linter
@pytest.mark.parametrize('page', WHOLE, ids=[page.stem for page in WHOLE])
def test_sentences_are_short(page: Path) -> None:
    """No sentence has more than 30 words; code and formulas are one each."""
    assert [words for words in sentences(prose(page)) if len(words) > LONGEST_SENTENCE] == []


@pytest.mark.linter
def test_words_of_messages() -> None:
    """Errors, warnings, log lines, diagnostics, help, reports and pages keep to the glossary."""
    said = [(message.place, message.text) for message in messages()]
    for page in (ROOT / 'tudor_dynamics' / 'show' / 'templates').glob('*.j2'):
        text = TAGS.sub(' ', page.read_text(encoding='utf-8'))
        said.append((page.name, re.sub(r'\s+', ' ', text)))
    found = [(place, match[0]) for place, text in said for phrase in SAID
             for match in re.finditer(phrase, text)]
    assert not found


@pytest.mark.linter
def test_words_of_docstrings() -> None:
    """The library's pages of the site are docstrings, and keep to the glossary as well."""
    found = [(str(path), name, match[0]) for path in (ROOT / 'tudor_dynamics').rglob('*.py')
             for name, text in docstrings(path) for phrase in PHRASES
             for match in re.finditer(phrase, text, re.IGNORECASE)]
    assert not found


@pytest.mark.linter
def test_spelling(tmp_path: Path) -> None:
    """The spelling of codespell, with the words of ``tools/words.txt``; pages and messages."""
    pytest.importorskip('codespell_lib')
    copies = []
    for page in WHOLE:
        copies.append(tmp_path / '_'.join(page.relative_to(ROOT).parts))
        copies[-1].write_text(WRITTEN.sub('', OUTPUT.sub('', kept(page))),
                              encoding='utf-8')
    copies.append(tmp_path / 'messages')
    copies[-1].write_text('\n'.join(f'{message.place}: {message.text}' for message in messages()))
    done = subprocess.run(
        [sys.executable, '-m', 'codespell_lib', '-D', '-', '-D', str(ROOT / 'tools/words.txt'),
         *map(str, copies)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr

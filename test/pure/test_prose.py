"""Plain English: phrases, docstring openings and names that a newcomer has to read twice.

The rules and examples are in CONTRIBUTING.md, section "Prose".
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

#: Phrases (regular expressions), and what to write instead.
PHRASES = {
    r"\banew\b": "again, or say what is recomputed",
    r"\bin vain\b": "without success",
    r"\bfor ever\b": "indefinitely",
    r"\b(the|a|its|at|each) begin\b": "start",
    r"\bwho(so)?ever\b": "the caller, the client, the node that ...",
    r"\b(some|any|no)body\b": "the operator, another node, no publisher",
    r"\b(is|are|was|were|be|been) told\b": "is given, receives, is configured with",
    r"\btells?\b": "reports, publishes, logs, returns",
    r"\b(is|are|not) heard\b|\bunheard\b": "is received, publishes nothing",
    r"\b(goes|went|going) on\b": "continues, resumes, in progress",
    r"\bcomes? of\b": "is caused by",
    r"\bcease[sd]?\b": "stops",
    r"\bstands? (still|there)\b|\bstood still\b": "is at rest, is paused, is in",
    r"\bso (many|much|long|far)\b(?! as)": "name the quantity",
    r"\bhardly (ever|any|anything)\b": "rarely, almost no",
    r"\blikewise\b": "also, or repeat the verb",
    r"\bhence(forth)?\b": "therefore, from then on",
    r"\bno more\b": "no longer",
    r"\bof no use\b": "unused, obsolete",
    r"\bstrangers?\b|\brivals?\b|\bthrift\b|\bbidden\b": "the field's word",
    r"\ball (that|which) (is|are|has|have|came|comes)\b": "everything ..., every message received",
}
#: Words that must not open a docstring: it starts with a verb or with the noun that the thing is.
OPENINGS = re.compile(
    r"(?:What|Whether|How|Where|Who|Whom|Whose|Which|That|Those|These|Of|As|If|From|When|All|It|"
    r"None|Such|By|Past|Beside)\b"
)
#: Names of functions and constants that state neither an action nor a quantity.
NAMES = re.compile(
    r"_*(?:told|take|taken|given?|heard?|hear|seen?|look|asked|said|own|near|far|late|known|"
    r"kept|held|put|go|goes|went|together|alike|within|begin|most|least|often|slow|quiet|apart|"
    r"ahead|patience|enough|again|still|worst|whole|plain|sure)_*",
    re.IGNORECASE,
)
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
GENERATED = {"parameters.md", "interfaces.md", "description.md"}  # their sources are checked
PACKAGES = sorted(path.name for path in (ROOT / "src").iterdir() if path.is_dir())
OTHERS = ["docs", "scripts", "config", "README.md", "CONTRIBUTING.md", "test/TRIALS.md"]


def files(place: Path) -> Iterator[Path]:
    """Yield the checked files below a folder, or the file itself."""
    for path in [place] if place.is_file() else sorted(place.rglob("*")):
        checked = path.suffix in {".py", ".md", ".sh", ".yaml", ".msg", ".srv", ".action"}
        if checked and path.is_file() and path.name not in GENERATED:
            yield path


def prose(path: Path, text: str) -> Iterator[tuple[int, str]]:
    """Yield (line, text) of comments, strings and, in Markdown, everything except code."""
    if path.suffix == ".md":
        code = False
        for number, line in enumerate(text.splitlines(), 1):
            code ^= line.lstrip().startswith("```")
            if not code:
                yield number, re.sub(r"`[^`]*`", "", line)
        return
    for number, line in enumerate(text.splitlines(), 1):
        if "#" in line:
            yield number, line.split("#", 1)[1]
        elif path.suffix == ".sh":
            yield from ((number, words) for words in re.findall(r'"([^"]* [^"]*)"', line))
    if path.suffix == ".py":
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
                for k, line in enumerate(node.value.splitlines()):
                    yield min(node.lineno + k, node.end_lineno or node.lineno), line


def names(tree: ast.Module) -> Iterator[tuple[int, str, str]]:
    """Yield (line, what, instead) of docstring openings, functions and constants."""
    for node in ast.walk(tree):
        if not isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        if match := OPENINGS.match(ast.get_docstring(node) or ""):
            yield node.body[0].lineno, match[0], "open with a verb, or the noun that it is"
        if isinstance(node, FUNCTIONS) and NAMES.fullmatch(node.name):
            yield node.lineno, node.name, "a verb and its object, or the noun returned"
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else []
        if isinstance(node, ast.AnnAssign):
            targets = [node.target]
        for name in (n for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)):
            if name.id.isupper() and NAMES.fullmatch(name.id):
                yield node.lineno, name.id, "name the quantity, as MAX_SEARCH_TIME"


def findings(path: Path, text: str) -> list[str]:
    """Return `file:line: phrase: what to write instead` for each finding in a file."""
    found = {
        (number, match.group(), instead)
        for number, line in prose(path, text)
        for phrase, instead in PHRASES.items()
        for match in re.finditer(phrase, line, re.IGNORECASE)
    }
    if path.suffix == ".py":
        found.update(names(ast.parse(text)))
    place = path.relative_to(ROOT) if path.is_relative_to(ROOT) else path
    return [f"{place}:{number}: {what}: {instead}" for number, what, instead in sorted(found)]


@pytest.mark.parametrize("place", [*(f"src/{name}" for name in PACKAGES), *OTHERS])
def test_prose_is_plain(place: str) -> None:
    found = [line for path in files(ROOT / place) for line in findings(path, path.read_text())]
    assert not found, "\n" + "\n".join(found)


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("a.py", '"""What it does."""\n', 1),
        ("a.py", "def told():\n    pass\n\n\nFAR = 1.0\n", 2),
        ("a.py", 'print(f"{3} waits for somebody")\n', 1),
        ("a.py", '"""Return the time."""\nMAX_AGE = 1.0  # [s]\n', 0),
        ("a.md", "It begins anew.\n\n```sh\ntell\n```\n`told`\n", 1),
        ("A.msg", "float64 x  # nobody knows\n", 1),
    ],
)
def test_the_check_finds_what_it_should(name: str, text: str, expected: int) -> None:
    assert len(findings(Path(name), text)) == expected

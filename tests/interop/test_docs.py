"""The user documentation is complete: every ruling, every input and option, and files and examples that are there."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest

from program import ROOT, binary

#: The page of each model.
PAGES = {
    "kael-astro-01": "astro.md",
    "kael-astro-03": "astro.md",
    "logiccon-trc": "trc.md",
    "logiccon-pfc24s-tcr": "pfc.md",
    "hmi-volcano-ec": "volcano.md",
}

#: The clauses that the specifications mark as rulings, wholly or in part, by the page that has to list them.
RULED = {
    "bus.md": ("BUS", [1, 3, 4, 12, 15, 22, 23]),
    "devices/astro.md": (
        "ASTRO",
        [1, 2, 12, 13, 14, 20, 21, 22, 23, 30, 31, 33, 34, 40, 42, 51, 52, 53, 60, 61, 63, 65, 66, 67, 80, 81, 82],
    ),
    "devices/trc.md": ("TRC", [1, 10, 11, 12, 13, 14, 15, 20]),
    "devices/pfc.md": ("PFC", [1, 3, 4, 5, 6, 10, 11, 12, 13, 15, 16, 17, 18, 19, 20]),
    "devices/volcano.md": ("VOL", [1, 2, 3, 5, 10, 12, 14, 15, 21, 22, 30, 40, 41, 42, 43, 44, 45, 47, 48, 50]),
}

DOCUMENTS = [
    path
    for folder in (".", "docs", "docs/devices", "fuzz", "scripts/pytest-standin")
    for path in sorted((ROOT / folder).glob("*.md"))
]


def page(name: str) -> str:
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def model(name: str, form: str) -> str:
    command = [binary(), "registers", name, "--format", form]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("name", RULED)
def test_every_ruling_is_listed(name: str) -> None:
    word, numbers = RULED[name]
    _, _, rulings = page(name).partition("\n## Rulings\n") if name != "bus.md" else ("", "", page(name))
    listed = {int(number) for number in re.findall(rf"\b{word}-(\d+)", rulings)}
    assert set(numbers) - listed == set()


def test_pfc_16_the_page_tells_when_a_protection_comes_and_goes() -> None:
    text = " ".join(page("devices/pfc.md").split())
    for part in ("beyond its limit for 1 s", "also with compensation 0", "2 % of the limit", "temperature has phase 0"):
        assert part in text, part


@pytest.mark.parametrize("name", PAGES)
def test_every_input_and_option_stands_on_the_page(name: str) -> None:
    known: dict[str, Any] = json.loads(model(name, "json"))
    names = [each["name"] for each in [*known["inputs"], *known["options"]]]
    text = page(f"devices/{PAGES[name]}")
    # `voltage_a`, `_b`, `_c` are three names.
    for first, others in re.findall(r"`(\w+)_a`((?:, `_\w`)+)", text):
        text += "".join(f"`{first}{end}`" for end in re.findall(r"`(_\w)`", others))
    assert [each for each in names if f"`{each}`" not in text] == []


@pytest.mark.parametrize("name", PAGES)
def test_the_readme_says_how_inputs_are_listed(name: str) -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "`standin registers MODEL --format markdown`" in readme
    listed = model(name, "markdown")
    assert all(f"| {each['name']} |" in listed for each in json.loads(model(name, "json"))["inputs"])


@pytest.mark.parametrize("name", sorted(set(PAGES.values())))
def test_the_example_of_a_page_is_a_device(name: str, tmp_path: Path) -> None:
    [example] = re.findall(r"^```toml\n(.*?)^```$", page(f"devices/{name}"), re.MULTILINE | re.DOTALL)
    config = tmp_path / "devices.toml"
    config.write_text(f'[[bus]]\nname = "line1"\nport = "pty:{tmp_path}/line1"\n{example}', encoding="utf-8")
    done = subprocess.run([binary(), "check", config], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_that_are_named_are_there(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    links = [link for link in re.findall(r"\]\(([^)#]+)\)", text) if "://" not in link]
    assert [link for link in links if not (document.parent / link).exists()] == []
    paths = re.findall(r"(?<![\w./-])(?:docs|fuzz|scripts|src|tests)/[\w./-]*\w", text)
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_the_readme_names_the_rust_that_is_needed() -> None:
    [needed] = re.findall(r'^rust-version = "([\d.]+)"$', (ROOT / "Cargo.toml").read_text(encoding="utf-8"), re.MULTILINE)
    assert f"Rust {needed} or newer" in (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("script", sorted((ROOT / "scripts").glob("*.py")), ids=lambda path: path.name)
def test_a_script_says_what_it_wants_installed(script: Path) -> None:
    text = script.read_text(encoding="utf-8")
    assert "import ModbusSerialClient" not in text or "    pip install pymodbus pyserial\n" in text


def test_a_device_of_the_example_answers_the_unit_that_the_scripts_take() -> None:
    bench = (ROOT / "devices.toml").read_text(encoding="utf-8")
    units = dict(re.findall(r'^model = "([\w-]+)".*?^unit = (\d+)', bench, re.MULTILINE | re.DOTALL))
    for script, of in {
        "set_astro_clock": "kael-astro-01",
        "astro_programs": "kael-astro-01",
        "set_volcano_target": "hmi-volcano-ec",
        "volcano_day": "hmi-volcano-ec",
        "pfc_report": "logiccon-pfc24s-tcr",
    }.items():
        text = (ROOT / "scripts" / f"{script}.py").read_text(encoding="utf-8")
        assert re.findall(r'"--unit".*default=(\d+)', text) == [units[of]], script

"""The documentation site: all names and effects are on it, and start-here runs."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from bayes_greybox.physics.catalogue.loading import DOMAINS, load_catalogue

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"

sys.path.append(str(DOCS / "_ext"))
effect_pictures = pytest.importorskip("effect_pictures")


def test_every_public_name_is_in_the_reference():
    stub = (ROOT / "bayes_greybox" / "__init__.pyi").read_text(encoding="utf-8")
    names = set(re.findall(r" as (\w+)$", stub, re.MULTILINE)) - {
        "priors",
        "systems",
        "signals",
        "plots",
        "study_figures",
    }
    shown = "\n".join(page.read_text(encoding="utf-8") for page in (DOCS / "reference").glob("*.rst"))
    listed = set(re.findall(r"^\.\. auto(?:class|function|exception):: (\w+)$", shown, re.MULTILINE))
    assert names and names == listed


@pytest.mark.parametrize("domain", DOMAINS)
def test_every_effect_has_an_entry_and_a_picture(domain, tmp_path):
    import catalogue_text

    text, kinds = catalogue_text.page(domain), {}
    for effect in load_catalogue(domain):
        assert f"(effect-{domain}-{effect.slug})=" in text and f"{domain}-{effect.slug}.svg" in text
        assert effect.meaning in text
        kinds.setdefault((bool(effect.hidden), len(effect.expr.free_symbols)), effect)
    # One of each kind of drawing; that of the whole site, a step of .ci/run, draws all.
    for effect in kinds.values():
        picture = tmp_path / f"{effect.slug}.svg"
        effect_pictures.save_picture(effect, picture)
        assert "<path" in picture.read_text(encoding="utf-8")


def test_every_howto_is_reached_from_the_questions():
    index = (DOCS / "howto" / "index.md").read_text(encoding="utf-8")
    pages = {page.name for page in (DOCS / "howto").glob("*.md")} - {"index.md"}
    assert pages == set(re.findall(r"\]\((\w+\.md)\)", index))


GALLERY = sorted((DOCS / "gallery").glob("*.py"))


def test_the_gallery_has_examples_of_verdicts_with_their_pictures():
    import gallery_text

    examples = [gallery_text.example(script) for script in GALLERY]
    assert len(examples) >= 12
    assert {each.verdict for each in examples} >= set(gallery_text.VERDICTS) - {"partly named"}
    shown = gallery_text.index(examples)
    for each in examples:
        assert (DOCS / "gallery" / f"{each.name}.png").is_file() and f"{each.name}.md" in shown
        text = gallery_text.page(each)
        assert text.startswith(f"# {each.title}\n") and each.output in text
        # What is on the page is the whole script.
        assert each.code.startswith("import ") and "study = bg.find_missing_effects(" in each.code
        assert max(map(len, text.splitlines())) <= 92


@pytest.mark.slow
@pytest.mark.parametrize("script", GALLERY, ids=lambda script: script.stem)
def test_the_gallery_says_what_the_studies_of_today_say(script):
    from bayes_greybox.data.datasets import dataset_table

    sys.path.append(str(DOCS))
    drawer = pytest.importorskip("draw_gallery")
    needed = set(re.findall(r'load_dataset\("(\w+)"', script.read_text(encoding="utf-8")))
    if not all(dataset_table().loc[sorted(needed), "found"]):
        pytest.skip("BAYES_GREYBOX_DATA names no folder with the measured record")
    assert drawer.said(drawer.study_of(script.stem)) == script.with_suffix(".txt").read_text(encoding="utf-8")


@pytest.mark.slow
def test_start_here_leads_to_the_verdict_that_it_shows(tmp_path):
    text = (DOCS / "start.md").read_text(encoding="utf-8")
    (made,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    commands = re.findall(r"^bayes-greybox (.+)$", text, re.MULTILINE)
    (rate,) = re.findall(r'^v = "F.*$', text, re.MULTILINE)
    subprocess.run([sys.executable, "-c", made], cwd=tmp_path, check=True)
    run = [sys.executable, "-m", "bayes_greybox"]
    subprocess.run([*run, *commands[0].split()], cwd=tmp_path, check=True, capture_output=True)
    config = tmp_path / "trolley.toml"
    known = re.sub(r"^# v = .*$", rate, config.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert "[dictionary]" in known
    config.write_text(re.sub(r"^\[dictionary\]\n(.+\n)*", "", known, flags=re.MULTILINE), "utf-8")
    done = subprocess.run([*run, *commands[1].split()], cwd=tmp_path, check=True, capture_output=True, text=True)
    shown = " ".join(done.stdout.split())
    verdict = "NAMED: The simulation lacks quadratic drag in d(v)/dt (probability > 0.999); adding it closes > 99.9 %"
    assert verdict in shown
    (said,) = re.findall(r"^NAMED: .*\n.*$", text, re.MULTILINE)
    assert verdict in " ".join(said.split())
    (coefficient,) = re.findall(r"The coefficient is (\S+ ± \S+ 1/m)", text)
    assert coefficient in shown

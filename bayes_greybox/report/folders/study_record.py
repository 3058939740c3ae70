"""A study as a plain record, for summary.json."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from bayes_greybox.criticism.convergence import convergence
from bayes_greybox.discovery.learned import studied_system
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.report.equations.record import equations_record
from bayes_greybox.report.words.asked import STUDY_FILE, asked
from bayes_greybox.report.words.doubts import doubts
from bayes_greybox.report.words.fit import data_remarks
from bayes_greybox.report.words.sentence import headline, sentence
from bayes_greybox.running.plain_values import plain_values

from .record import verdict_record


def study_record(study: StudyResult, sampling: Mapping[str, Any]) -> dict[str, Any]:
    """Return the verdict, equations, doubts, convergence, tables and data of a study, and its settings."""
    fit, test = study.fit, study.test
    return plain_values(
        {
            "verdict": study.verdict,
            "sentence": sentence(study),
            "headline": headline(study),
            "equations": equations_record(studied_system(study)),
            **study.record(),
            "asked": [asdict(each) for each in asked(study, STUDY_FILE)],
            "doubts": [asdict(each) for each in doubts(study)],
            "convergence": None if fit is None else verdict_record(convergence(fit)),
            "data": {
                "train": study.train.n_obs,
                "test": None if test is None else test.n_obs,
                "of": study.base.rows.in_words(study.train),
                "remarks": data_remarks(study.train, test),
            },
            "sampling": dict(sampling),
        }
    )

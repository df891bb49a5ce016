"""Where the parts of a study lie in its folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from benchmark.errors import StoreError

#: How the two uses of a study are called where they are kept.
PEOPLE_DATABASE, REHEARSAL_DATABASE = "people.sqlite3", "rehearsal.sqlite3"


@dataclass(frozen=True)
class StudyFolder:
    """A study folder: what raters see, what they must not see, and what they answered, each in a place of its own.

    ``plan.json`` and ``stimuli/`` say nothing of methods; ``private/`` holds the key, the observers' evidence and the secret
    that signs the plan; ``answers/`` the databases; ``texts/`` what the researcher edits.
    """

    path: Path

    @property
    def plan(self) -> Path:
        """The signed plan."""
        return self.path / "plan.json"

    @property
    def stimuli(self) -> Path:
        """Folder of the videos."""
        return self.path / "stimuli"

    @property
    def texts(self) -> Path:
        """Folder of the texts that the researcher edits."""
        return self.path / "texts"

    @property
    def private(self) -> Path:
        """Folder of what raters must not see."""
        return self.path / "private"

    @property
    def secret(self) -> Path:
        """The secret that signs the plan and makes the ids."""
        return self.private / "secret"

    @property
    def key(self) -> Path:
        """What was shown under each id, as a stimuli file of ``eval.ratings``."""
        return self.private / "key.csv"

    @property
    def evidence(self) -> Path:
        """Scores of each stimulus, which simulated observers answer from."""
        return self.private / "evidence.csv"

    @property
    def rendered(self) -> Path:
        """Digest of each video that is ready, so that an interrupted build goes on."""
        return self.private / "rendered.jsonl"

    @property
    def settings(self) -> Path:
        """What the study was built with."""
        return self.private / "settings.json"

    @property
    def answers(self) -> Path:
        """Folder of the databases."""
        return self.path / "answers"

    def database(self, *, rehearsal: bool) -> Path:
        """The database of people's answers, or that of rehearsals."""
        return self.answers / (REHEARSAL_DATABASE if rehearsal else PEOPLE_DATABASE)

    def video(self, stimulus: str) -> Path:
        """The video of a stimulus of the plan."""
        return self.stimuli / f"{stimulus}.mp4"

    def results(self, *, rehearsal: bool) -> Path:
        """Folder of the analysis."""
        return self.path / ("rehearsal" if rehearsal else "analysis")

    def check_built(self) -> None:
        """Refuse a folder that holds no finished study.

        Raises
        ------
        StoreError
            Saying how to make one.
        """
        if not self.plan.is_file():
            unfinished = " (its build was interrupted: run it again)" if self.settings.is_file() else ""
            raise StoreError(
                f"{self.path} has no plan.json{unfinished}: make a study with `python -m benchmark study build RUN -o "
                f"{self.path}`"
            )

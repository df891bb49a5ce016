"""The plan of a study: what the site shows to whom, in which order; nothing of what a stimulus is."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from benchmark.digest import canonical_json, file_digest
from benchmark.errors import StoreError
from reports.study.layout import StudyFolder
from reports.study.sign import signature, verify

#: Version of the plan's format.
FORMAT = 1

#: Seconds that answering a page takes beyond watching once; assumed for the estimate of a session's length.
ANSWER_SECONDS = 8.0
#: Seconds for consent, instructions and thanks.
FRAME_SECONDS = 120.0

Identifier = Field(pattern=r"^[0-9a-f]{16}$")


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Stimulus(_Strict):
    """A video by its id: digest, size in bytes, and the answers offered to the action question."""

    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    bytes: int = Field(gt=0)
    actions: tuple[str, ...] = ()


class Order(_Strict):
    """One session: the stimuli in order, and which of the two styles is the first answer on its pages."""

    stimuli: tuple[str, ...]
    first_style: Literal[0, 1]


class Plan(_Strict):
    """What was decided at the build.

    Attributes
    ----------
    format
        :data:`FORMAT`.
    source
        Data set and licence, as under every video.
    styles
        Source and target style: the two answers to the first question.
    seconds
        Length of every video.
    min_watch
        Seconds that a video must have been on the page before an answer to it counts.
    action_question
        ``list``, ``text`` or ``none``.
    raters
        Finished sessions that the study is planned for; enrolment closes there.
    same_size
        Whether all figures were brought to one size.
    example
        Id of the video of the instructions, shown to everybody and never asked about; empty if there is none.
    stimuli
        By id.
    orders
        Sessions, taken in turn.
    key_sha256, evidence_sha256
        Digests of the key and of the evidence, which lie apart.
    """

    format: Literal[1]
    source: str
    styles: tuple[str, str]
    seconds: float = Field(gt=0)
    width: int
    height: int
    min_watch: float = Field(ge=0)
    action_question: Literal["list", "text", "none"]
    raters: int = Field(ge=1)
    same_size: bool
    example: str
    stimuli: dict[str, Stimulus]
    orders: tuple[Order, ...] = Field(min_length=1)
    key_sha256: str
    evidence_sha256: str

    @model_validator(mode="after")
    def _consistent(self) -> Plan:
        asked = set(self.stimuli) - {self.example}
        for number, order in enumerate(self.orders):
            if len(order.stimuli) != len(asked) or set(order.stimuli) != asked:
                raise ValueError(f"order {number} does not show every stimulus once")
        return self

    @property
    def digest(self) -> str:
        """SHA-256 of the plan; answers belong to one plan."""
        from benchmark.digest import digest

        return digest(self.model_dump(mode="json"))

    @property
    def pages(self) -> int:
        """Stimuli of a session."""
        return len(self.orders[0].stimuli)

    @property
    def minutes(self) -> float:
        """Estimated length of a session."""
        return (self.pages * (max(self.seconds, self.min_watch) + ANSWER_SECONDS) + FRAME_SECONDS) / 60.0


def write_plan(folder: StudyFolder, plan: Plan, secret: bytes) -> None:
    """Write the plan with its signature, whole or not at all."""
    from benchmark.motion._atomic import atomic_write

    body = plan.model_dump(mode="json")
    text = json.dumps({"plan": body, "signature": signature(canonical_json(body).encode(), secret)}, indent=1)
    atomic_write(folder.plan, [text.encode()])


def read_plan(folder: StudyFolder, *, check_videos: bool = True) -> Plan:
    """Read the plan and hold it, the videos, the key and the evidence against its signature.

    Parameters
    ----------
    folder
        The study.
    check_videos
        Whether to read every video.

    Raises
    ------
    StoreError
        Naming what is missing, altered, or not part of the plan.
    """
    folder.check_built()
    document = _load(folder.plan)
    if not isinstance(document, dict) or set(document) != {"plan", "signature"}:
        raise StoreError(f"{folder.plan} is no plan of a study: it must hold a plan and its signature")
    if not folder.secret.is_file():
        raise StoreError(f"{folder.secret} is missing: without it the plan's signature cannot be checked; restore it")
    try:
        text = canonical_json(document["plan"]).encode()
    except Exception as error:
        raise StoreError(f"{folder.plan} is no plan of a study: {error}") from error
    if not verify(text, str(document["signature"]), folder.secret.read_bytes()):
        raise StoreError(
            f"{folder.plan} was changed after it was signed: restore it from a copy, or build the study anew in another folder"
        )
    try:
        plan = Plan.model_validate(document["plan"])
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "plan"
        raise StoreError(f"{folder.plan}, {where}: {first['msg']}") from error
    for path, digest, what in (
        (folder.key, plan.key_sha256, "the key"),
        (folder.evidence, plan.evidence_sha256, "the evidence"),
    ):
        _same(path, digest, what)
    if check_videos:
        for name, stimulus in plan.stimuli.items():
            _same(folder.video(name), stimulus.sha256, "the stimulus")
        known = {folder.video(name).name for name in plan.stimuli}
        for path in sorted(folder.stimuli.iterdir()):
            if path.name not in known:
                raise StoreError(f"{path} is not in the plan: take it away")
    return plan


def _load(path: Path) -> Any:
    try:
        return json.loads(path.read_bytes())
    except (ValueError, UnicodeDecodeError) as error:
        raise StoreError(f"{path} is not JSON: {error}") from error


def _same(path: Path, digest: str, what: str) -> None:
    if not path.is_file():
        raise StoreError(f"{path} is missing: {what} belongs to the signed plan; restore it from a copy")
    if file_digest(path) != digest:
        raise StoreError(f"{path} was changed after the plan was signed: restore {what} from a copy")

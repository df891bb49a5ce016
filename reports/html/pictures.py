"""The figures on the page: grouped by what they show, inline, and within a budget of bytes."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

from reports.drawing import SavedDrawing

#: Bytes that all figures together may take on the page; a byte of a picture takes 4/3 in base64.
BUDGET = 12_000_000

#: Pictures are made smaller down to this width in pixels, and left out rather than made smaller still.
NARROWEST = 700

#: Where a figure stands on the page, by the name of its files; the first pattern that fits counts.
_KINDS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("Motion", ("pose-strip*", "comparison-strip*", "trajector*", "joint-change*", "tempo*", "jump-*")),
    (
        "Comparison of methods",
        ("critical-difference*", "style-content*", "style-similarity*", "cost-quality*", "ablation*"),
    ),
    ("Scores of every metric", ("metrics-*",)),
    ("Ratings", ("rating*",)),
    ("Training", ("loss-curves*",)),
)
_OTHER = "Other figures"


@dataclass(frozen=True)
class Picture:
    """One figure as the page shows it; ``data`` is empty where it did not fit."""

    name: str
    kind: str
    alt: str
    caption: str
    data: bytes
    width: int
    height: int
    pdf: str
    csv: str

    @property
    def source(self) -> str:
        """The picture as a data URI."""
        return f"data:image/png;base64,{base64.b64encode(self.data).decode()}"


@dataclass(frozen=True)
class Gallery:
    """All figures by kind, and what had to be done so that they fit."""

    groups: Mapping[str, Sequence[Picture]]
    notes: Sequence[str]


def gallery(drawings: Sequence[SavedDrawing], budget: int = BUDGET) -> Gallery:
    """The figures, in their own pixels where they fit into ``budget`` bytes together.

    Where they do not, first all are reduced to 256 colours, then the widest are halved in turn, and at last the largest are
    left out; a note says which of it was done.
    """
    pictures = [_picture(drawing) for drawing in drawings]
    notes = []
    if _bytes(pictures) > budget:
        pictures = [replace(picture, data=_palette(picture.data)) for picture in pictures]
        notes.append("colours of the figures on this page are reduced")
    halved = 0
    while _bytes(pictures) > budget:
        sizes = [len(picture.data) if picture.width > NARROWEST else 0 for picture in pictures]
        if not any(sizes):
            break
        place = sizes.index(max(sizes))
        pictures[place] = _narrower(pictures[place])
        halved += 1
    if halved:
        notes.append("some figures are smaller on this page than in their own files")
    left_out = 0
    while _bytes(pictures) > budget:
        place = max(range(len(pictures)), key=lambda index: len(pictures[index].data))
        pictures[place] = replace(pictures[place], data=b"")
        left_out += 1
    if left_out:
        notes.append(
            f"{left_out} of {len(pictures)} figures would make this page too large and are in their own files only"
        )
    if notes:
        notes[-1] += ": the folder figures has all of them whole"
    order = [kind for kind, _ in _KINDS] + [_OTHER]
    return Gallery({kind: found for kind in order if (found := [p for p in pictures if p.kind == kind])}, notes)


def _bytes(pictures: Iterable[Picture]) -> int:
    return sum(len(picture.data) * 4 // 3 for picture in pictures)


def _picture(drawing: SavedDrawing) -> Picture:
    data = drawing.png.read_bytes()
    width, height = _size(data)
    return Picture(
        name=drawing.name,
        kind=kind_of(drawing.name),
        alt=alternative(drawing),
        caption=drawing.caption,
        data=data,
        width=width,
        height=height,
        pdf=f"../figures/{drawing.pdf.name}",
        csv=f"../figures/{drawing.csv.name}",
    )


def kind_of(name: str) -> str:
    """The heading under which a figure of that name stands."""
    for kind, patterns in _KINDS:
        if any(fnmatchcase(name, pattern) for pattern in patterns):
            return kind
    return _OTHER


def alternative(drawing: SavedDrawing) -> str:
    """What stands for the picture where it cannot be seen: which figure it is, and the first sentence of its caption.

    The rest of the caption follows it on the page and need not be read out twice.
    """
    words = drawing.name.replace("-", " ")
    first = re.split(r"(?<=[.:;]) ", drawing.caption, maxsplit=1)[0].rstrip(".:;")
    return f"{words[:1].upper()}{words[1:]}: {first}. The numbers drawn are in {drawing.csv.name}."


def _size(data: bytes) -> tuple[int, int]:
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        return image.size


def _palette(data: bytes) -> bytes:
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        flat = Image.new("RGB", image.size, "white")
        flat.paste(image, mask=image.convert("RGBA").getchannel("A"))
        out = io.BytesIO()
        flat.quantize(256).save(out, "PNG", optimize=True)
    return min(data, out.getvalue(), key=len)


def _narrower(picture: Picture) -> Picture:
    from PIL import Image

    with Image.open(io.BytesIO(picture.data)) as image:
        width = max(NARROWEST, picture.width // 2)
        height = max(1, round(picture.height * width / picture.width))
        out = io.BytesIO()
        image.convert("RGB").resize((width, height), Image.Resampling.LANCZOS).quantize(256).save(
            out, "PNG", optimize=True
        )
    return replace(picture, data=out.getvalue(), width=width, height=height)

"""The score of a performance: where the feet stand and when, how high the hips are, what the upper body does.

An action writes a score for one body and one style; :mod:`benchmark.data.synthetic.perform` turns it into joint rotations.
Times are seconds from the start of the action, lengths metres, angles radians. Heading 0 faces +Z; left is +X.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from benchmark.data.synthetic.body import Body
from benchmark.data.synthetic.content import Content
from benchmark.data.synthetic.curves import remembered, soft_polyline
from benchmark.data.synthetic.styles import StyleParameters

Array = NDArray[np.float64]

GRAVITY = 9.81

#: Leg length (hip to ankle, metres) for which nominal durations are given; others scale with its square root (Froude).
REFERENCE_LEG = 0.85

#: A planted leg is never straighter than this fraction of its length, so that the knee never locks or pops.
REACH = 0.994

#: Resting values of the upper body's channels that are not zero; the style adds to some.
CHANNELS: tuple[str, ...] = (
    "pelvis_yaw",
    "pelvis_pitch",
    "pelvis_roll",
    "shift_x",
    "shift_z",
    "bend",
    "side",
    "twist",
    "head_pitch",
    "head_yaw",
    "head_roll",
    *(f"{part}_{side}" for side in "LR" for part in ("flex", "abd", "turn", "elbow", "wrist")),
)


@dataclass
class Plant:
    """One stance of one foot, and the swing that leads to it.

    ``strike`` and ``push`` are the pitch of the foot when it lands and when it leaves, positive with the heel up. ``settle``
    is the time in seconds in which it comes flat, ``peel`` the part of the stance in which the heel rises, ``follow`` the part
    of the swing in which it goes on rising. ``lift`` is the clearance of the swing before it in metres, ``skew`` its timing
    (see :func:`~benchmark.data.synthetic.curves.bump`), ``rise`` the height of the hop, if it left with the body; ``hold`` the
    leg's angle and extension if it is held up meanwhile.
    """

    on: float
    off: float
    x: float
    z: float
    yaw: float
    strike: float = 0.0
    push: float = 0.6
    settle: float = 0.1
    peel: float = 0.45
    follow: float = 0.25
    lift: float = 0.06
    skew: float = 0.0
    rise: float = 0.0
    hold: tuple[float, float] | None = None


@dataclass(frozen=True)
class Support:
    """A stance of one foot or both in a sequence of steps, hops and landings.

    Attributes
    ----------
    feet
        ``"L"``, ``"R"`` or ``"LR"``.
    advance, turn
        How far the body goes on from the support before, and by how much it turns (to the left if positive).
    period
        Seconds from the touch-down before to this one.
    overlap
        Seconds for which the support before lasts on after this touch-down; negative for a flight.
    apart
        Distance between the tracks of the feet.
    lift, skew, strike, push, hold
        As in :class:`Plant`, for the swing that leads here and the stance.
    phase
        How far the arms go on, in half strides.
    crouch
        Additional lowering of the hips over this support.
    """

    feet: str
    advance: float
    turn: float
    period: float
    overlap: float
    apart: float
    lift: float = 0.06
    skew: float = 0.0
    strike: float = -0.25
    push: float = 0.7
    hold: tuple[float, float] | None = None
    phase: float = 1.0
    crouch: float = 0.0


@dataclass
class Score:
    """A performance to be, on one body in one style."""

    body: Body
    style: StyleParameters
    content: Content
    feet: dict[str, list[Plant]] = field(default_factory=dict)
    heights: list[tuple[float, float, float, float]] = field(default_factory=list)
    path: list[tuple[float, float, float, float]] = field(default_factory=list)
    path_width: float = 0.3
    moves: dict[str, list[tuple[float, float, float]]] = field(default_factory=dict)
    waves: list[tuple[str, Callable[[Array], Array]]] = field(default_factory=list)
    pitch_moves: dict[str, list[tuple[float, float, float]]] = field(default_factory=dict)
    holds: dict[str, list[tuple[float, float, float, float, float, float]]] = field(default_factory=dict)
    free: dict[str, dict[str, list[tuple[float, float, float]]]] = field(default_factory=dict)
    flights: list[tuple[float, float]] = field(default_factory=list)
    end: float = 0.0
    _drawn: int = 0

    @property
    def leg(self) -> float:
        """Leg length, metres."""
        return self.body.leg

    @property
    def second(self) -> float:
        """Actual seconds in a nominal second: scaled to the leg, then by the tempo of the style."""
        return float(np.sqrt(self.leg / REFERENCE_LEG)) / self.style.tempo

    @property
    def stand(self) -> float:
        """Height of the hip joints in quiet standing."""
        return self.body.ankle_height + self.leg * (REACH - 0.004 - self.style.knee_bend)

    def vary(self) -> float:
        """The next random factor near 1, as far from it as the style is variable."""
        draws = self.content.draws
        value = draws[self._drawn % len(draws)]
        self._drawn += 1
        return 1.0 + self.style.variability * float(value)

    def vary_even(self, count: int) -> list[float]:
        """The next ``count`` random factors, with mean 1: they change the rhythm but not the rate."""
        factors = np.array([self.vary() for _ in range(count)])
        return [float(f) for f in factors - factors.mean() + 1.0]

    def move(self, channel: str, onset: float, duration: float, change: float) -> None:
        """Change ``channel`` by ``change`` in a minimum-jerk movement."""
        if channel not in CHANNELS:
            raise KeyError(channel)
        self.moves.setdefault(channel, []).append((onset, duration, change))

    def pose(self, channel_values: dict[str, float], onset: float, duration: float) -> None:
        """Bring channels to values, counted from rest; movements to one channel must be given in the order of their time."""
        for channel, value in channel_values.items():
            now = sum(change for _, _, change in self.moves.get(channel, []))
            self.move(channel, onset, duration, value - now)

    def wave(self, channel: str, shape: Callable[[Array], Array]) -> None:
        """Add a function of time to ``channel``."""
        if channel not in CHANNELS:
            raise KeyError(channel)
        self.waves.append((channel, shape))

    def stand_still(self, width: float | None = None) -> None:
        """Put both feet beside each other at the origin, for good."""
        half = self.body.hip_half_width * self.style.step_width if width is None else 0.5 * width
        for side, sign in (("L", 1.0), ("R", -1.0)):
            self.feet[side] = [Plant(-np.inf, np.inf, sign * half, 0.0, sign * 0.10)]
        self.path = [(0.0, 0.0, 0.0, 0.0)]

    def step(self, side: str, lift_off: float, touch_down: float, plant: Plant) -> None:
        """Let the foot on ``side`` leave its last plant and land on another."""
        self.feet[side][-1].off = lift_off
        plant.on = touch_down
        self.feet[side].append(plant)

    def travel(
        self, start: float, supports: Sequence[Support], *, flight_reach: float = 0.95, over: float = 0.5
    ) -> TravelPlan:
        """Plan a sequence of supports, from standing to standing.

        Footholds follow from walking the advances and turns; hips pass over each foothold in the middle of its stance, at
        constant speed between; their height swings between double support (low, as far as the reach of the legs needs)
        and mid stance, or follows a ballistic arc wherever there is a flight.

        Parameters
        ----------
        start
            When the first foot leaves the floor.
        supports
            The sequence. The feet of the last two supports stay where they land.
        flight_reach
            Distance from hip to ankle at take-off and landing, as a fraction of the leg.
        over
            When in a stance the hips are above the foot, as a fraction of it.
        """
        count = len(supports)
        touch = start + np.cumsum([support.period for support in supports])
        heading, position = 0.0, np.zeros(2)
        poses = []
        for support in supports:
            heading += support.turn
            middle = heading - 0.5 * support.turn
            position = position + support.advance * np.array([np.sin(middle), np.cos(middle)])
            poses.append((*position, heading))
        for side in "LR":
            self._plants(side, start, supports, touch, poses)
        middles = [touch[-1] + 0.3 * self.second] * count
        for j in range(count - 1):
            stance = touch[j + 1] + supports[j + 1].overlap - touch[j]
            if supports[j].overlap < 0:
                # However long it lasts, a stance that ends a flight is passed over at the speed of the flight.
                stance = min(stance, supports[j].period + supports[j].overlap)
            middles[j] = touch[j] + over * stance
        self.path = [(start, 0.0, 0.0, 0.0)] + [(float(m), *pose) for m, pose in zip(middles, poses, strict=True)]
        self.path_width = 1.1 * float(np.median([support.period for support in supports]))
        self._heights(start, supports, touch, middles, flight_reach)
        self.end = float(touch[-1] + 0.6 * self.second)
        return TravelPlan(start, tuple(float(x) for x in touch), tuple(float(m) for m in middles), tuple(supports))

    def _plants(self, side: str, start: float, supports: Sequence[Support], touch: Array, poses: list) -> None:
        sign = 1.0 if side == "L" else -1.0
        half = self.body.hip_half_width * self.style.step_width
        plants = [Plant(-np.inf, np.inf, sign * half, 0.0, sign * 0.10)]
        inside = -1
        for j, support in enumerate(supports):
            if side not in support.feet:
                continue
            following = inside + 1
            leave = touch[following] + supports[following].overlap
            if following == j and support.overlap >= 0:
                leave = max(touch[j] - 0.8 * support.period, start)
            x, z, yaw = poses[j]
            offset = 0.5 * support.apart * sign
            hop = supports[following].overlap < 0 and following == j
            plants[-1].off = float(leave)
            plants[-1].push = supports[following].push
            if supports[following].overlap < 0:
                # Pushing off into flight, the heel is up before the toes leave.
                plants[-1].peel, plants[-1].follow = 0.7, 0.10
            air = -support.overlap if hop else 0.0
            plants.append(
                Plant(
                    float(touch[j]),
                    np.inf,
                    x + offset * np.cos(yaw),
                    z - offset * np.sin(yaw),
                    yaw + sign * 0.10,
                    strike=support.strike,
                    lift=support.lift,
                    skew=support.skew,
                    rise=GRAVITY * air**2 / 8.0,
                    hold=support.hold if not hop else None,
                )
            )
            inside = j
        self.feet[side] = plants

    def _heights(
        self, start: float, supports: Sequence[Support], touch: Array, middles: Sequence[float], flight_reach: float
    ) -> None:
        leg, ankle = self.leg, self.body.ankle_height
        bend = self.style.knee_bend * leg
        extra = 0.012 * leg * (self.style.bounce - 1.0)
        nodes = [(min(start, touch[0] - supports[0].period), self.stand, 0.0, 0.0)]
        flying = ankle + flight_reach * leg - bend
        count = len(supports)
        for j, support in enumerate(supports):
            if support.overlap < 0:
                air = -support.overlap
                speed = 0.5 * GRAVITY * air
                height = flying - support.crouch
                nodes.append((touch[j] - air, height, speed, -GRAVITY))
                nodes.append((touch[j], height, -speed, -GRAVITY))
                self.flights.append((float(touch[j] - air), float(touch[j])))
                if j + 1 < count and supports[j + 1].overlap >= 0:
                    # Walking on from a landing: absorb it first.
                    absorb = min(0.22 * self.second * self.style.landing, 0.45 * supports[j + 1].period)
                    sunk = height - 0.5 * speed * absorb
                    nodes.append((touch[j] + absorb, sunk, 0.0, 0.9 * speed / absorb))
            else:
                reach = 0.58 * support.advance
                high = ankle + leg * 0.978 - bend - support.crouch
                low = ankle + np.sqrt((0.982 * leg) ** 2 - reach**2) - bend - support.crouch - extra
                low = min(low, high - 0.004 * leg)
                omega = np.pi / support.period
                bow = 0.5 * (high - low) * omega**2
                nodes.append((touch[j] + 0.5 * support.overlap, low, 0.0, bow))
                following_walks = j + 1 < len(supports) and supports[j + 1].overlap >= 0
                if following_walks:
                    nodes.append((middles[j], high, 0.0, -bow))
        nodes.append((touch[-1] + 0.55 * self.second * self.style.landing, self.stand, 0.0, 0.0))
        self.heights = nodes


@dataclass(frozen=True)
class TravelPlan:
    """When the supports of a :meth:`Score.travel` touch down and are passed over."""

    start: float
    touch: tuple[float, ...]
    middles: tuple[float, ...]
    supports: tuple[Support, ...]

    def phase(self) -> Callable[[Array], Array]:
        """Gait phase in radians: an even multiple of pi at touch-downs of the left foot, an odd one at those of the right."""
        first = next(s for s in self.supports if len(s.feet) == 1)
        value = 0.0 if first.feet == "L" else np.pi
        knots, values = [self.start], [value - np.pi * self.supports[0].phase]
        value = values[0]
        for time, support in zip(self.touch, self.supports, strict=True):
            value += np.pi * support.phase
            knots.append(time)
            values.append(value)
        width = 0.5 * float(np.median([support.period for support in self.supports]))
        return remembered(lambda t: soft_polyline(t, knots, values, width))

    def intensity(self, nominal: float) -> Callable[[Array], Array]:
        """From 0 in standing to 1 in full stride of ``nominal`` metres."""
        values = [0.0]
        values += [
            float(np.clip(s.advance / nominal, 0.35 if s is not self.supports[-1] else 0.0, 1.0)) for s in self.supports
        ]
        width = 1.3 * float(np.median([support.period for support in self.supports]))
        knots = [self.start, *self.middles]
        return remembered(lambda t: soft_polyline(t, knots, values, width))

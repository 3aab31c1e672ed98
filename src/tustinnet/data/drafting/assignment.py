"""The assignment of roles to columns for which most evidence speaks, and by how much."""

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from tustinnet.data.drafting.evidence import FEWEST_JOINTS, ROLES, WEIGHTS, EvidenceTable, Role
from tustinnet.data.drafting.relations import Pairs
from tustinnet.data.drafting.vocabulary import OUTSIDE

NO_REASON = "nothing else fits"
_MANY_FAMILIES = 14  # families; of more of them no two are swapped
_MOST_ROUNDS = 50  # in which a better assignment is found

Roles = Int[np.ndarray, " c"]
"""The role of each column, by its place in `ROLES`."""
_POSITION, _VELOCITY, _ACCELERATION, _INPUT, _SET_POINT, _OTHER = range(len(ROLES))


@dataclass(frozen=True)
class Verdict:
    """The role of a column, and what speaks for it.

    Attributes:
        role: its role.
        reasons: the sentences that speak for it, the strongest first.
        rival: the role that it has in the best assignment in which it is used otherwise.
        margin: how much better the assignment is than that, in points; 0 of a name's role.
        near: a smaller margin is a question.
        partner: the column of which it is the velocity or set point, or that it moves, if any.
        is_by_name: whether the rival is what its name states.
    """

    role: Role
    reasons: tuple[str, ...]
    rival: Role | None = None
    margin: float = np.inf
    near: float = WEIGHTS.near
    partner: str | None = None
    is_by_name: bool = False

    @property
    def because(self) -> str:
        """The reasons as one text."""
        return "; ".join(self.reasons)

    @property
    def is_open(self) -> bool:
        """Whether another role is nearly as likely."""
        return self.margin < self.near

    @property
    def leads(self) -> str | None:
        """The column that follows it as its set point, None without one."""
        return self.partner if self.role == "set point" else None


class _Prices:
    """Prices of pairs of columns that have certain roles.

    Attributes:
        positions: of two positions: one place twice, or a place and its rate.
        velocities: of two velocities.
        motion: of an input that repeats a position or velocity, unless its name says that it is
            an input.
        inputs: of two inputs that are proportional, or stages of one drive.
        are_related: whether one is a copy, a derivative or a set point of the other.
    """

    def __init__(self, t: EvidenceTable) -> None:
        w, columns = WEIGHTS, range(len(t.names))
        positions = np.array([t.says(i, "position") for i in columns])
        inputs = np.array([t.says(i, "input") for i in columns])
        plain = np.array([r.qualifier in (None, "measured") for r in t.readings])
        are_of_block = np.zeros((len(columns), len(columns)), bool)
        for block in t.blocks:
            places = [*block.values()]
            are_of_block[np.ix_(places, places)] = True
        is_said = np.outer(positions, positions) | are_of_block
        # a stiff machine moves as one, and motor and load are two positions nevertheless
        share = np.where(is_said & np.outer(plain, plain), 0.25, 1.0)
        # joints of a block are of one kind: none is the rate of another one
        rates = np.where(are_of_block, 0.0, np.maximum(0.0, np.maximum(t.slope, t.slope.T)))
        self.positions = rates + share * t.repeats
        self.velocities = np.where(are_of_block, 0.25, 1.0) * t.repeats
        self.motion = np.where(inputs[:, None], 0.0, t.repeats)
        is_copy = t.repeats > 0
        family = np.array(t.family)
        # as of several propellers, which balance one another
        is_same = (family[:, None] == family) & inputs
        self.inputs = np.where(is_copy & ~is_same, t.repeats + 0.5 * w.copy, 0.0)
        for prices in (self.positions, self.velocities, self.motion):
            prices[t.is_copy] = 3 * w.copy  # whatever their names say
        for prices in (self.positions, self.velocities, self.inputs):
            np.fill_diagonal(prices, 0.0)
        related = is_copy | (t.slope > 0) | (t.follow > 0)
        self.are_related = related | related.T
        # a current at one joint is no effect of the force at another one, nor of a hand's
        is_other = [bool(OUTSIDE & {*r.words}) for r in t.readings]
        sizes = Counter(t.family)
        is_of_many = [sizes[f] > 1 and t.joint[i] is not None for i, f in enumerate(t.family)]
        joints = {joint for joint in t.joint if joint is not None}
        members = {f: {t.joint[i] for i, g in enumerate(t.family) if g == f} for f in sizes}
        drives_all = [len(joints) >= FEWEST_JOINTS and members[f] == joints for f in t.family]
        are_stages = np.array(
            [
                [
                    # of several joints two families of inputs are stages, whatever their names say,
                    # and beside what drives every joint nothing else does
                    (
                        t.stage[u] != t.stage[v]
                        or (
                            t.family[u] != t.family[v]
                            and (
                                (is_of_many[u] and is_of_many[v]) or drives_all[u] or drives_all[v]
                            )
                        )
                    )
                    and not (is_other[u] or is_other[v])
                    and (t.joint[u] == t.joint[v] or None in (t.joint[u], t.joint[v]))
                    for v in columns
                ]
                for u in columns
            ]
        )
        self.inputs += w.stage * are_stages


class Assignment:
    """The search for the roles for which most evidence speaks."""

    def __init__(self, table: EvidenceTable, answers: Mapping[str, Role]) -> None:
        """Finds the best roles.

        Args:
            table: the evidence.
            answers: roles that are known, by column, which hold for its family.
        """
        self.table = table
        self.families = {
            family: np.flatnonzero(np.array(table.family) == family)
            for family in dict.fromkeys(table.family)
        }
        self.held = {
            table.family[table.names.index(name)]: ROLES.index(role)
            for name, role in answers.items()
            if name in table.names
        }
        self.prices = _Prices(table)
        says_input = [table.says(i, "input") for i in range(len(table.names))]
        self.no_input = WEIGHTS.no_input * (1.0 if any(says_input) else 0.75)
        self.is_command = np.array(says_input) & (np.array(table.stage) == "command")
        self.cache: dict[bytes, float] = {}
        self.related = {
            pair: bool(self.prices.are_related[np.ix_(*(self.families[f] for f in pair))].any())
            for pair in itertools.product(self.families, repeat=2)
        }
        self.roles, self.margins, self.rivals = self._find_best()

    # --- the score ---

    def score(self, roles: Roles) -> float:
        """The points of an assignment."""
        key = roles.tobytes()
        if key not in self.cache:
            self.cache[key] = float(self._score(roles))
        return self.cache[key]

    def _score(self, roles: Roles) -> float:
        t, w = self.table, WEIGHTS
        by_role: list[list[int]] = [[] for _ in ROLES]
        for column, role in enumerate(roles.tolist()):
            by_role[role].append(column)
        positions, velocities, accelerations, inputs, set_points, others = by_role
        total = float(t.points[np.arange(len(roles)), roles].sum())
        pairs = self.pair_rates(positions, velocities)
        total += sum(float(t.slope[p, v]) for v, p in pairs.items())
        total -= w.no_velocity * (len(positions) - len(pairs)) if pairs else 0.0
        orphans = [v for v in velocities if v not in pairs]
        total -= w.alone * (len(orphans) if positions else 0.5)
        second = self.pair_rates([*pairs] if positions else velocities, accelerations)
        total += sum(0.5 * float(t.slope[v, a]) for a, v in second.items())
        # a number without a name that is the slope of no velocity
        total -= w.no_slope * sum(t.is_nameless[a] for a in accelerations if a not in second)
        motion = [*positions, *velocities]
        total += sum(
            max(t.follow[r, motion].tolist(), default=-0.5 * w.no_follow) for r in set_points
        )
        total += self._input_points(inputs, positions or orphans, others)
        total -= _sum(self.prices.positions, positions, positions) / 2
        total -= _sum(self.prices.velocities, velocities, velocities) / 2
        total -= _sum(self.prices.motion, inputs, motion)
        if t.sums and len(positions) > 2:
            signals = {*t.signal[positions].tolist()}
            total -= 2 * w.copy * sum({*t.signal[[*three]].tolist()} <= signals for three in t.sums)
        if not inputs:
            total -= 0.5 if set_points else self.no_input
        return total - (0.0 if motion else w.no_position)

    def pair_rates(self, columns: Sequence[int], rates: Sequence[int]) -> dict[int, int]:
        """The column of which each rate is the derivative, the best pairs first."""
        if not columns or not rates:
            return {}
        slope = self.table.slope[columns][:, rates]
        possible = np.argwhere(slope > -0.75 * WEIGHTS.no_slope).tolist()
        pairs: dict[int, int] = {}
        for i, j in sorted(possible, key=lambda pair: -slope[pair[0], pair[1]]):
            if rates[j] not in pairs and columns[i] not in pairs.values():
                pairs[rates[j]] = columns[i]
        return pairs

    def _input_points(
        self, inputs: Sequence[int], moved: Sequence[int], others: Sequence[int]
    ) -> float:
        """Points of what inputs move, and the prices of several inputs of one machine."""
        if not inputs:
            return 0.0
        t, w = self.table, WEIGHTS
        causes = t.cause[inputs][:, moved].max(axis=1, initial=-9.0 if moved else -1.0)
        # what is named a command may also move a later stage of its drive, as a current
        effects = [k for k in others if t.stage[k] != "command"]
        later = t.cause[inputs][:, effects].max(axis=1, initial=-9.0)
        causes = np.maximum(causes, np.where(self.is_command[inputs], later, -9.0))
        total = float(causes.sum()) - _sum(self.prices.inputs, inputs, inputs) / 2
        families = {t.family[u] for u in inputs}
        return total - w.further_input * max(0, len(families) - 1)

    # --- the search ---

    def _find_best(self) -> tuple[Roles, dict[int, float], dict[int, int]]:
        """The best roles; by family the margin, and the role in the best assignment without it."""
        start = np.zeros(len(self.table.names), int)
        for members in self.families.values():
            start[members] = np.argmax(self.table.points[members].sum(axis=0))
        start = self._with(start, self.held)
        free = [f for f in self.families if f not in self.held]
        best = self._climb(start)
        margins: dict[int, float] = {}
        rivals: dict[int, int] = {}
        for _ in range(_MOST_ROUNDS):
            uses = self.uses(best)
            for family in free:
                members = self.families[family]
                others = [
                    self._climb(self._with(best, {family: r}), family) for r in range(len(ROLES))
                ]
                near = [o for o in others if (self.uses(o)[members] != uses[members]).any()]
                rival = max(near, key=self.score)
                margins[family] = self.score(best) - self.score(rival)
                rivals[family] = int(rival[members[0]])
                better = max(others, key=self.score)
                if self.score(better) > self.score(best) + 1e-9:
                    break
            else:
                break
            best = self._climb(better)  # it takes the place of the best
        return best, margins, rivals

    def _with(self, roles: Roles, choice: Mapping[int, int]) -> Roles:
        """Roles in which some families have others."""
        changed = roles.copy()
        for family, role in choice.items():
            changed[self.families[family]] = role
        return changed

    def _climb(self, roles: Roles, kept: int | None = None) -> Roles:
        """Changes the role of one family, or swaps two, as long as that is better.

        Args:
            roles: where to begin.
            kept: a family that keeps its role; of many families only those that it has to do with
                change then.
        """
        free = [f for f in self.families if f not in self.held and f != kept]
        if kept is not None and len(free) > _MANY_FAMILIES:
            free = [f for f in free if self.related[kept, f]]
        while True:
            before = self.score(roles)
            for family in free:
                changed = (self._with(roles, {family: r}) for r in range(len(ROLES)))
                roles = max((roles, *changed), key=self.score)
            if self.score(roles) > before + 1e-9:
                continue
            if len(free) > _MANY_FAMILIES:
                return roles
            first = {f: int(roles[self.families[f][0]]) for f in free}
            swaps = (
                self._with(roles, {f: first[g], g: first[f]})
                for f, g in itertools.combinations(free, 2)
                if first[f] != first[g]
            )
            roles = max((roles, *swaps), key=self.score)
            if self.score(roles) <= before + 1e-9:
                return roles

    # --- what follows from it ---

    def uses(self, roles: Roles) -> Roles:
        """The roles that the card has: what is not used is `other`.

        A speed alone is the coordinate, and a set point alone the input.
        """
        uses = roles.copy()
        positions, velocities = _columns(roles, _POSITION), _columns(roles, _VELOCITY)
        pairs = self.pair_rates(positions, velocities)
        alone = [v for v in velocities if v not in pairs]
        uses[alone] = _OTHER if positions else _POSITION
        if not (roles == _INPUT).any():
            uses[roles == _SET_POINT] = _INPUT
        uses[(uses == _ACCELERATION) | (uses == _SET_POINT)] = _OTHER
        return uses

    def verdicts(self) -> dict[str, Verdict]:
        """The role of each column with its reasons."""
        return {name: self._verdict(i) for i, name in enumerate(self.table.names)}

    def _verdict(self, i: int) -> Verdict:
        t, family, role = self.table, self.table.family[i], int(self.roles[i])
        if family in self.held:
            return Verdict(ROLES[role], ("as you say",))
        positions, velocities = (_columns(self.roles, r) for r in (_POSITION, _VELOCITY))
        pairs = self.pair_rates(positions, velocities)
        points, others, text = {
            _VELOCITY: (t.slope[:, i], [pairs[i]] if i in pairs else [], "slope of '{}'"),
            _ACCELERATION: (t.slope[:, i], velocities, "slope of '{}'"),
            _INPUT: (t.cause[i], positions or velocities, "it foretells '{}'"),
            _SET_POINT: (t.follow[i], [*positions, *velocities], "'{}' follows it, one to one"),
        }.get(role, (t.slope[i], [], ""))
        # of several joints that of its own name or number
        own = [p for p in others if t.joint[i] is not None and t.joint[p] == t.joint[i]]
        related = [p for p in own or others if role == _VELOCITY or points[p] > 0]
        other = max(related, key=lambda p: points[p], default=None)
        reasons = [(e.points, e.sentence) for e in t.own[i] if e.role == ROLES[role]]
        partner = None
        if other is not None:
            partner = t.names[other]
            reasons.append((float(points[other]), text.format(partner)))
        ordered = sorted((r for r in reasons if r[0] > 0), key=lambda r: -r[0])
        use = int(self.uses(self.roles)[i])
        # that nothing else could be the motion is no reason
        named = t.contradicting(i, ROLES[role]) if use == _POSITION else None
        return Verdict(
            ROLES[role],
            tuple(dict.fromkeys(r[1] for r in ordered)) or (NO_REASON,),
            named or ROLES[self.rivals[family]],
            0.0 if named else self.margins[family],
            WEIGHTS.near_of_used if use in (_POSITION, _INPUT) else WEIGHTS.near,
            partner,
            named is not None,
        )


def _columns(roles: Roles, role: int) -> list[int]:
    """The columns that have a role."""
    return np.flatnonzero(roles == role).tolist()


def _sum(prices: Pairs, rows: Sequence[int], columns: Sequence[int]) -> float:
    """The sum of the prices of some pairs."""
    return float(prices[rows][:, columns].sum()) if rows and columns else 0.0

"""Systems in the channels of records."""

from collections.abc import Sequence
from dataclasses import replace

from tustinnet.data.experiment import Experiment
from tustinnet.models.lagrangian import LagrangianSystem


def arrange_system(system: LagrangianSystem, records: Sequence[Experiment]) -> LagrangianSystem:
    """The system alone in the channels of records, with ranges by their motion.

    Where a system and records declare different holds, those of the records count.

    Args:
        system: the system, with a controller in the loop or without.
        records: records of one kind, at least one.

    Raises:
        InputError: records of another system.
    """
    alone = [e.without_controller() for e in records]
    first = alone[0]
    system = system.plant.for_records(alone, f"record '{first.name}'")
    declared = {i.name: i.hold for i in first.inputs if i.has_hold}
    inputs = tuple(
        replace(i, hold=None) if i.hold != declared.get(i.name, i.hold) else i
        for i in system.inputs
    )
    if inputs != system.inputs:
        system = replace(system, inputs=inputs)
    system.channels.require_same(
        first.channels,
        first.name,
        f"the system '{system.name}'",
        remedy="; a draft for a system (init, `system=`) has them",
    )
    return system

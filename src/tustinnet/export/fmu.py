"""A model as FMUs for co-simulation, FMI 2.0 and 3.0, made of its C."""

import io
import platform
import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from uuid import UUID
from xml.etree import ElementTree as Xml

from tustinnet.export.c import compile_c, find_compiler, library_step, make_model_files
from tustinnet.export.source import Source
from tustinnet.export.target import Files, NotRunnable, Stepper, Target
from tustinnet.export.words import fill_template

IDENTIFIER = "model"  # prefix of the functions, and name of the binary
FILES = {2: "model-fmi2.fmu", 3: "model-fmi3.fmu"}
_LIBRARY = {2: f"binaries/linux64/{IDENTIFIER}.so", 3: f"binaries/x86_64-linux/{IDENTIFIER}.so"}
_FLAGS = ("-std=c99", "-O2", "-fPIC")
# an FMU calls its own functions, whatever others of the same names are in the process
_SHARED = ("-shared", "-s", "-Wl,-Bsymbolic")
_ZIP_TIME = (1980, 1, 1, 0, 0, 0)  # of every file in the archive: same content, same bytes
# the units of coordinates in base units of FMI
_BASES = {"rad": {"rad": "1"}, "m": {"m": "1"}, "s": {"s": "1"}}
_BASES |= {"rad/s": {"rad": "1", "s": "-1"}, "m/s": {"m": "1", "s": "-1"}}


class Fmu(Target):
    """Functional mock-up units, for simulators of systems."""

    name = "fmu"

    def files(self, source: Source) -> Files:
        """`model-fmi2.fmu` and `model-fmi3.fmu`, with binaries where they can be compiled."""
        description = _Description.from_source(source)
        sources = {v: _sources(source, v) for v in FILES}
        content = "".join(sorted({text for files in sources.values() for text in files.values()}))
        # the token identifies the model, and so depends on everything in it
        token = f"{{{UUID(sha256(f'{content}{description}'.encode()).hexdigest()[:32])}}}"
        for files in sources.values():
            files["fmu.h"] = files["fmu.h"].replace("@token@", token)
        libraries = _libraries(sources)
        archives: Files = {}
        for v, name in FILES.items():
            contents = {"modelDescription.xml": description.xml(v, token, sources[v]).encode()}
            contents |= {f"sources/{file}": text.encode() for file, text in sources[v].items()}
            if v == 3:
                contents["sources/buildDescription.xml"] = _build_description(sources[v]).encode()
            if v in libraries:
                contents[_LIBRARY[v]] = libraries[v]
            archives[name] = _archive(contents)
        return archives

    def stepper(self, folder: Path, source: Source) -> Stepper:
        """A step by the binary in the FMU, without its interface."""
        with zipfile.ZipFile(folder / FILES[3]) as archive, tempfile.TemporaryDirectory() as place:
            if _LIBRARY[3] not in archive.namelist():
                _require_platform()
                find_compiler()
                raise NotRunnable("the FMU has sources only, as its C was not compiled")
            library = archive.extract(_LIBRARY[3], place)
            return library_step(Path(library), source.n_x)


def _sources(source: Source, version: int) -> dict[str, str]:
    """The C files of an FMU by name, headers too."""
    offsets = source.input_layout.offsets
    return {
        **make_model_files(source, linearised=False, parts=source.integrates),
        "fmu.h": fill_template(
            "fmu.h",
            inputs=source.channels.n_u,
            samples=len(offsets),
            past=max(-min(offsets), 0),
            integrates=int(source.integrates),
            parameters=len(source.parameters),
        ),
        "fmu.c": fill_template(
            "fmu.c",
            offsets=", ".join(map(str, offsets)),
            values=", ".join(repr(value) for _, _, value in source.parameters) or "0",
        ),
        f"fmi{version}.c": fill_template(f"fmi{version}.c"),
    }


def _require_platform() -> None:
    """Raises unless binaries can be made on this machine."""
    if (platform.system(), platform.machine()) != ("Linux", "x86_64"):
        raise NotRunnable("the FMU has sources only: binaries are made on Linux on x86-64")


def _libraries(sources: Mapping[int, Mapping[str, str]]) -> dict[int, bytes]:
    """Shared libraries by version; none where they cannot be compiled."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for files in sources.values():
            for name, text in files.items():
                (folder / name).write_text(text, encoding="utf-8")
        try:
            _require_platform()
            compile_c([folder / "model.c"], folder / "model.o", (*_FLAGS, "-c"))
            for v in sources:
                parts = [folder / name for name in (f"fmi{v}.c", "fmu.c", "model.o")]
                compile_c(parts, folder / f"{v}.so", (*_FLAGS, *_SHARED))
        except NotRunnable:
            return {}  # the stepper reports the reason
        return {v: (folder / f"{v}.so").read_bytes() for v in sources}


def _archive(contents: Mapping[str, bytes]) -> bytes:
    """A zip archive whose bytes depend on the contents only."""
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w") as archive:
        for name, content in contents.items():
            entry = zipfile.ZipInfo(name, _ZIP_TIME)
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content, zipfile.ZIP_DEFLATED)
    return memory.getvalue()


def _build_description(sources: Iterable[str]) -> str:
    """`buildDescription.xml` of FMI 3.0, by which the sources are compiled."""
    root = Xml.Element("fmiBuildDescription", fmiVersion="3.0")
    build = Xml.SubElement(root, "BuildConfiguration", modelIdentifier=IDENTIFIER)
    files = Xml.SubElement(build, "SourceFileSet", language="C99")
    for name in _compiled(sources):
        Xml.SubElement(files, "SourceFile", name=name)
    Xml.SubElement(build, "Library", name="m")
    return _document(root)


def _compiled(sources: Iterable[str]) -> list[str]:
    return [name for name in sources if name.endswith(".c")]


def _document(root: Xml.Element) -> str:
    Xml.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{Xml.tostring(root, encoding="unicode")}\n'


@dataclass(frozen=True)
class _Description:
    """The content of the model description in both versions.

    Attributes:
        title: the name of the model.
        states: names and units of the states, in the order of their references.
        inputs: names and units of the inputs, whose references follow.
        parameters: names, units and values of constants, whose references follow that of time.
        period: the period of a step [s].
        text: notes for users of the FMU.
    """

    title: str
    states: tuple[tuple[str, str], ...]
    inputs: tuple[tuple[str, str], ...]
    parameters: tuple[tuple[str, str, float], ...]
    period: float
    text: str

    @classmethod
    def from_source(cls, source: Source) -> "_Description":
        inputs = [i.name for i in source.channels.inputs]
        parameters = [name for name, _, _ in source.parameters]
        _, *names = _unique(["time", *source.states, *inputs, *parameters])  # `time` is FMI's own
        units = [*source.units, *(i.unit for i in source.channels.inputs)]
        channels = tuple(zip(names, units, strict=False))
        title = f"model of {', '.join(c.name for c in source.channels.coordinates)}"
        period = float(source.channels.dt)
        constants = tuple(
            (name, unit, value)
            for name, (_, unit, value) in zip(
                names[len(channels) :], source.parameters, strict=True
            )
        )
        notes = [
            f"Communication steps are of any length, with inputs as they are at the beginning. "
            f"The period of the model is {period!r} s: "
            + (
                "its equations are integrated in steps of at most that."
                if source.integrates
                else "it steps by that, with the means of the inputs over it; states in between "
                "are interpolated."
            )
        ]
        if max(source.input_layout.offsets) > 0:
            notes.append(
                "A step depends on later inputs too: an importer of FMI 2.0 may tell them by the "
                "derivatives of the inputs, otherwise inputs are taken as held."
            )
        if min(source.input_layout.offsets) < 0:
            notes.append("Inputs before the first step are taken as the first ones.")
        own_names = [*source.states, *inputs, *parameters]
        notes += [
            f"'{own}' is called '{name}' here."
            for own, name in zip(own_names, names, strict=True)
            if own != name
        ]
        notes += [f"Note: {note}." for note in source.notes]
        n = source.n_x
        return cls(title, channels[:n], channels[n:], constants, period, " ".join(notes))

    def xml(self, version: int, token: str, sources: Iterable[str]) -> str:
        """`modelDescription.xml`."""
        newer = version == 3
        root = Xml.Element(
            "fmiModelDescription",
            fmiVersion=f"{version}.0",
            modelName=self.title,
            description=self.text,
            generationTool="tustinnet",
            variableNamingConvention="flat",
        )
        root.set("instantiationToken" if newer else "guid", token)
        simulated = Xml.SubElement(
            root,
            "CoSimulation",
            modelIdentifier=IDENTIFIER,
            canHandleVariableCommunicationStepSize="true",
        )
        if newer:
            more = {
                "canGetAndSetFMUState": "true",
                "canSerializeFMUState": "true",
                "fixedInternalStepSize": repr(self.period),
            }
        else:
            more = {
                "canGetAndSetFMUstate": "true",
                "canSerializeFMUstate": "true",
                "canInterpolateInputs": "true",
                "canNotUseMemoryManagementFunctions": "true",
            }
            files = Xml.SubElement(simulated, "SourceFiles")
            for name in _compiled(sources):
                Xml.SubElement(files, "File", name=name)
        simulated.attrib.update(more)
        self._units(root)
        kinds = Xml.SubElement(root, "LogCategories")
        Xml.SubElement(kinds, "Category", name="logStatusError")
        Xml.SubElement(root, "DefaultExperiment", stepSize=repr(self.period))
        self._variables(root, newer=newer)
        return _document(root)

    def _units(self, root: Xml.Element) -> None:
        all_units = [variable[1] for variable in (*self.states, *self.inputs, *self.parameters)]
        used = dict.fromkeys([unit for unit in all_units if unit] + ["s"])
        units = Xml.SubElement(root, "UnitDefinitions")
        for name in used:
            unit = Xml.SubElement(units, "Unit", name=name)
            if name in _BASES:
                Xml.SubElement(unit, "BaseUnit", _BASES[name])

    def _variables(self, root: Xml.Element, *, newer: bool) -> None:
        variables = Xml.SubElement(root, "ModelVariables")
        structure = Xml.SubElement(root, "ModelStructure")
        outputs = structure if newer else Xml.SubElement(structure, "Outputs")

        def add(about: dict[str, str], start: str, unit: str) -> None:
            number = {"start": start, **({"unit": unit} if unit else {})}
            if newer:
                Xml.SubElement(variables, "Float64", {**about, **number})
            else:
                Xml.SubElement(Xml.SubElement(variables, "ScalarVariable", about), "Real", number)

        for reference, (name, unit) in enumerate((*self.states, *self.inputs)):
            is_state = reference < len(self.states)
            about = {
                "name": name,
                "valueReference": str(reference),
                "causality": "output" if is_state else "input",
                "variability": "continuous",
                **({"initial": "exact"} if is_state else {}),
            }
            add(about, "0", unit)
            if is_state and newer:
                Xml.SubElement(outputs, "Output", valueReference=str(reference), dependencies="")
            elif is_state:
                Xml.SubElement(outputs, "Unknown", index=str(reference + 1), dependencies="")
        time = len(self.states) + len(self.inputs)
        if newer:
            Xml.SubElement(
                variables,
                "Float64",
                name="time",
                causality="independent",
                unit="s",
                valueReference=str(time),
                variability="continuous",
            )
        for reference, (name, unit, value) in enumerate(self.parameters, time + 1):
            about = {
                "name": name,
                "valueReference": str(reference),
                "causality": "local",
                "variability": "constant",
                "initial": "exact",
            }
            add(about, repr(value), unit)


def _unique(names: Iterable[str]) -> list[str]:
    """Names, repeated ones with a number."""
    unique: list[str] = []
    for name in names:
        candidate, count = name, 1
        while candidate in unique:
            count += 1
            candidate = f"{name}_{count}"
        unique.append(candidate)
    return unique


TARGET = Fmu()

"""A model as FMUs for co-simulation, FMI 2.0 and 3.0, made of its C."""

import io
import platform
import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple
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
# attributes of variables
_STATE = {"causality": "output", "variability": "continuous", "initial": "exact"}
_INPUT = {"causality": "input", "variability": "continuous"}
_TIME = {"causality": "independent", "variability": "continuous"}
_CONSTANT = {"causality": "local", "variability": "constant", "initial": "exact"}
# what an FMU can do, by version
_ABILITIES = {
    2: (
        "canGetAndSetFMUstate",
        "canSerializeFMUstate",
        "canInterpolateInputs",
        "canNotUseMemoryManagementFunctions",
    ),
    3: ("canGetAndSetFMUState", "canSerializeFMUState"),
}


class Fmu(Target):
    """Functional mock-up units, for simulators of systems."""

    name = "fmu"

    def files(self, source: Source) -> Files:
        """`model-fmi2.fmu` and `model-fmi3.fmu`, with binaries where they can be compiled."""
        sources = {v: _sources(source, v) for v in FILES}
        descriptions = {v: _describe(source, v, sources[v]) for v in FILES}
        texts = {text for files in sources.values() for text in files.values()}
        content = "".join(sorted({*texts, *map(_document, descriptions.values())}))
        # the token identifies the model, and so depends on everything in it
        token = f"{{{UUID(sha256(content.encode()).hexdigest()[:32])}}}"
        for v, files in sources.items():
            files["fmu.h"] = files["fmu.h"].replace("@token@", token)
            descriptions[v].set("instantiationToken" if v == 3 else "guid", token)
        libraries = _libraries(sources)
        archives: Files = {}
        for v, name in FILES.items():
            contents = {"modelDescription.xml": _document(descriptions[v]).encode()}
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


class _Variable(NamedTuple):
    """A variable of an FMU.

    Attributes:
        name: its name in the FMU.
        own: its name in the model.
        unit: its unit, or empty.
        start: its value at the start, empty for the time.
        kind: the attributes of its kind.
    """

    name: str
    own: str
    unit: str
    start: str
    kind: Mapping[str, str]


def _variables(source: Source) -> list[_Variable]:
    """States, inputs, time and parameters, in the order of their references."""
    channels = source.channels
    rows = [
        ("time", "s", "", _TIME),  # first: the name is FMI's own
        *(
            (name, unit, "0", _STATE)
            for name, unit in zip(source.states, source.units, strict=True)
        ),
        *((i.name, i.unit, "0", _INPUT) for i in channels.inputs),
        *((name, unit, repr(value), _CONSTANT) for name, unit, value in source.parameters),
    ]
    names = _unique(own for own, *_ in rows)
    time, *variables = [_Variable(n, *row) for n, row in zip(names, rows, strict=True)]
    variables.insert(source.n_x + channels.n_u, time)
    return variables


def _notes(source: Source, variables: Iterable[_Variable]) -> str:
    """Notes for users of the FMU."""
    notes = [
        "Communication steps are of any length, with inputs as they are at the beginning. "
        f"The period of the model is {float(source.channels.dt)!r} s: "
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
    notes += [f"'{v.own}' is called '{v.name}' here." for v in variables if v.own != v.name]
    return " ".join([*notes, *(f"Note: {note}." for note in source.notes)])


def _describe(source: Source, version: int, sources: Iterable[str]) -> Xml.Element:
    """The content of `modelDescription.xml`, without its token."""
    variables, period = _variables(source), repr(float(source.channels.dt))
    root = Xml.Element(
        "fmiModelDescription",
        fmiVersion=f"{version}.0",
        modelName=f"model of {', '.join(c.name for c in source.channels.coordinates)}",
        description=_notes(source, variables),
        generationTool="tustinnet",
        variableNamingConvention="flat",
    )
    simulated = Xml.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=IDENTIFIER,
        canHandleVariableCommunicationStepSize="true",
    )
    simulated.attrib.update(dict.fromkeys(_ABILITIES[version], "true"))
    if version == 3:
        simulated.set("fixedInternalStepSize", period)
    else:
        files = Xml.SubElement(simulated, "SourceFiles")
        for name in _compiled(sources):
            Xml.SubElement(files, "File", name=name)
    units = Xml.SubElement(root, "UnitDefinitions")
    for name in dict.fromkeys(v.unit for v in variables if v.unit):
        unit = Xml.SubElement(units, "Unit", name=name)
        if name in _BASES:
            Xml.SubElement(unit, "BaseUnit", _BASES[name])
    kinds = Xml.SubElement(root, "LogCategories")
    Xml.SubElement(kinds, "Category", name="logStatusError")
    Xml.SubElement(root, "DefaultExperiment", stepSize=period)
    _add_variables(root, variables, newer=version == 3)
    return root


def _add_variables(root: Xml.Element, variables: Iterable[_Variable], *, newer: bool) -> None:
    """Adds variables, and which of them are outputs."""
    elements = Xml.SubElement(root, "ModelVariables")
    structure = Xml.SubElement(root, "ModelStructure")
    outputs = structure if newer else Xml.SubElement(structure, "Outputs")
    for reference, v in enumerate(variables):
        about = {"name": v.name, "valueReference": str(reference), **v.kind}
        number = {key: text for key, text in (("start", v.start), ("unit", v.unit)) if text}
        if newer:
            Xml.SubElement(elements, "Float64", {**about, **number})
        elif v.kind is not _TIME:
            Xml.SubElement(Xml.SubElement(elements, "ScalarVariable", about), "Real", number)
        if v.kind is _STATE and newer:
            Xml.SubElement(outputs, "Output", valueReference=str(reference), dependencies="")
        elif v.kind is _STATE:
            Xml.SubElement(outputs, "Unknown", index=str(reference + 1), dependencies="")


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

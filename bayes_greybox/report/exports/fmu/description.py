"""Description of an FMU: modelDescription.xml of FMI 2.0."""

from importlib.metadata import version
from xml.etree import ElementTree

from bayes_greybox.data.writing import unit_text

from ..header import uncertainty
from ..model import ExportedModel
from ..names import one_line


def description(model: ExportedModel, name: str, called: str, guid: str, about: str) -> bytes:
    """Return the text of modelDescription.xml; value references are those of fmi2.c.

    Args:
        model: The model.
        name: Name that users see.
        called: Name of its library.
        guid: Identifier by which library and description recognise each other.
        about: Description in a sentence.
    """
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=one_line(name),
        guid=guid,
        description=one_line(about),
        generationTool=f"bayes_greybox {version('bayes-greybox')}",
        variableNamingConvention="flat",
        numberOfEventIndicators="0",
    )
    for kind, able in (("ModelExchange", {}), ("CoSimulation", {"canHandleVariableCommunicationStepSize": "true"})):
        own = {"modelIdentifier": called, "canNotUseMemoryManagementFunctions": "true"}
        offered = ElementTree.SubElement(root, kind, {**own, **able})
        ElementTree.SubElement(ElementTree.SubElement(offered, "SourceFiles"), "File", name="fmi2.c")
    units = [each.unit for each in (*model.quantities, *model.formulas, *model.factors)]
    if named := dict.fromkeys(text for text in map(unit_text, units) if text):
        definitions = ElementTree.SubElement(root, "UnitDefinitions")
        for text in named:
            ElementTree.SubElement(definitions, "Unit", name=text)
    variables = ElementTree.SubElement(root, "ModelVariables")

    def variable(name: str, about: str, unit: str, number: dict[str, str], **kind: str) -> None:
        attributes = {"name": name, "valueReference": str(len(variables)), "description": one_line(about), **kind}
        scalar = ElementTree.SubElement(variables, "ScalarVariable", attributes)
        text = unit_text(unit)
        ElementTree.SubElement(scalar, "Real", {**number, **({"unit": text} if text else {})})

    for each in model.states:
        # One that moves along with another where a run starts is calculated from it.
        known = {} if each.follows else {"start": repr(each.start)}
        variable(
            each.name, each.about, each.unit, known, causality="output", variability="continuous",
            initial="calculated" if each.follows else "exact",
        )  # fmt: skip
    for k, each in enumerate(model.rates):
        of = {"derivative": str(k + 1)}
        # Per second, whatever the data's time is in.
        unit = each.unit if model.per_second == 1.0 else ""
        variable(f"der({each.name})", "", unit, of, causality="local", variability="continuous")
    for each in model.inputs:
        variable(each.name, each.about, each.unit, {"start": "0.0"}, causality="input", variability="continuous")
    for each in model.outputs:
        variable(each.name, each.about, each.unit, {}, causality="output", variability="continuous")
    for each in model.factors:
        mean = {"start": repr(float(each.value.mean))}
        variable(
            each.name, uncertainty(each), each.unit, mean, causality="parameter", variability="tunable", initial="exact"
        )

    n, inputs = len(model.states), len(model.inputs)
    states, rates = range(1, n + 1), range(n + 1, 2 * n + 1)
    outputs = range(2 * n + inputs + 1, 2 * n + inputs + len(model.outputs) + 1)
    following = [k for k, each in zip(states, model.states, strict=True) if each.follows]
    structure = ElementTree.SubElement(root, "ModelStructure")
    groups = (
        ("Outputs", [*states, *outputs]),
        ("Derivatives", rates),
        ("InitialUnknowns", [*following, *rates, *outputs]),
    )
    for group, places in groups:
        if places:
            parent = ElementTree.SubElement(structure, group)
            for place in sorted(places):
                ElementTree.SubElement(parent, "Unknown", index=str(place))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)

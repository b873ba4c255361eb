"""Several policies in one evaluation: all in the scenario of the first, each by a name of its own."""

from collections.abc import Sequence

from foveate.errors import InputError
from foveate.experiment.resolve import Name, NamedPolicy, Subject, subject_of
from foveate.io.progress import logger
from foveate.scenario.scenario import Scenario
from foveate.simulation.records import Policy


def subjects_of(
    policy: NamedPolicy | Policy | Name | Sequence[NamedPolicy | Name], scenario: Scenario | None = None
) -> list[Subject]:
    """Resolve one policy, or several: these in the scenario of the first, with a warning where it is not theirs.

    Raises as `subject_of`.
    """
    if isinstance(policy, str) or not isinstance(policy, Sequence):
        return [subject_of(policy, scenario)]
    if not policy:
        raise InputError("policy: expected at least one")
    subjects = [subject_of(each, scenario) for each in policy]
    names = [each.name for each in subjects]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"policy {twice[0]}: is given twice: expected each once, of its own name")
    shared = subjects[0].experiment.scenario
    for each in subjects[1:]:
        if each.experiment.scenario != shared:
            logger.warning(
                f"warning: {each.name} was trained in another scenario than {subjects[0].name}, in which it runs"
            )
    return [subjects[0], *(subject_of(each, shared) for each in policy[1:])]


def other_period(subject: Subject) -> list[str]:
    """A line where a policy runs at another period than that of its training."""
    trained_s, tau_s = subject.trained_tau_s, subject.experiment.scenario.tau_s
    if trained_s is None or trained_s == tau_s:
        return []
    return [f"{subject.name} was trained for a period of {trained_s:g} s, and runs at {tau_s:g} s here"]


def policies_of(subject: Subject, others: Sequence[Subject], methods: Sequence[str]) -> dict[str, Policy]:
    """The policies of methods, by their names: for "policy" one of each subject's name, where there are several.

    Warns where one runs at another period than that of its training.
    """
    found: dict[str, Policy] = {}
    if "policy" in methods:
        for line in (line for each in (subject, *others) for line in other_period(each)):
            logger.warning(f"warning: {line}")
    for method in methods:
        if method == "policy" and others:
            found |= {each.name: each.network() for each in (subject, *others)}
        else:
            found[method] = subject.policy(method)
    return found

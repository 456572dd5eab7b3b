"""What a reader should know beside a diagnosis, in sentences."""

from __future__ import annotations

from tossid.diagnosis.findings import FEWEST_TOSSES
from tossid.diagnosis.result import Diagnosis
from tossid.diagnosis.simulators import Simulator


def remarks_on(found: Diagnosis, simulator: Simulator) -> tuple[str, ...]:
    """Remarks on how many tosses there are, on their order, and on their law of contact.

    Args:
        found: The diagnosis.
        simulator: Of what.
    """
    return (*_of_number(found), *_of_order(found), *_of_contact(found, simulator))


def _of_number(found: Diagnosis) -> tuple[str, ...]:
    """A remark where nothing was found, and too few tosses took part for a name."""
    n = found.n_tosses
    if found.found or found.verdict == "no_gap" or n >= FEWEST_TOSSES:
        return ()
    return (
        f"{n} tosses are too few: even if all agreed, that could be chance, given how many effects are tried. Some "
        "twelve are needed to name an effect of contact, and fewer for one of flight.",
    )


def _of_order(found: Diagnosis) -> tuple[str, ...]:
    """A remark where too few tosses took part for a change over their order."""
    if found.changes_left is not None:
        return ()
    return (f"{len(found.tosses)} tosses are too few for a change of an effect over their order to be seen.",)


def _of_contact(found: Diagnosis, simulator: Simulator) -> tuple[str, ...]:
    """A remark where tosses follow another law of contact than the simulator's."""
    if found.contact == simulator.law.name:
        return ()
    if simulator.mjcf is not None:
        return (
            "These tosses follow rigid contact more closely than your model's own contact. The effects are fitted "
            "with rigid contact, and the patch makes the model's contact rigid (solref, solimp, a shorter time step "
            "and an elliptic cone).",
        )
    if found.contact == "relaxed":
        return (
            "These tosses follow MuJoCo's relaxed friction, in which a sliding contact lifts off, more closely than "
            "Coulomb's law. The effects are fitted with relaxed friction.",
        )
    if found.contact == "routh":
        return (
            "In these tosses, friction of an impact is against the slip as it turns meanwhile (Routh's law), more than "
            "against the slip after the impact, as in simulators that resolve impacts at once. The effects are fitted "
            "with Routh's law.",
        )
    return ("These tosses follow Coulomb's law of friction more closely than the simulator's own law.",)

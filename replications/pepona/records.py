"""Numbers that need a real record: computed on demand, outside the time of a default replication."""

from sysid.replication import Session

WIENER_HAMMERSTEIN = "wiener_hammerstein_test_rmse_mv"


def record_numbers(session: Session) -> tuple[dict[str, float | None], dict[str, str]]:
    """Return the numbers of real records, and why those are missing that are."""
    return {WIENER_HAMMERSTEIN: None}, {WIENER_HAMMERSTEIN: "not computed: add --with-records"}

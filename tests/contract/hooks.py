"""A check that schemathesis does not have: only the meaning of a valid request may be refused."""

import schemathesis

# Faults of form. Where a request that follows the description has one of them, the description is not precise.
FORM = {
    "bad-json",
    "duplicate-field",
    "empty",
    "invalid-key",
    "invalid-query",
    "invalid-system",
    "invalid-value",
    "malformed-body",
    "missing-field",
    "out-of-range",
    "unexpected-body",
    "unknown-field",
    "unknown-value",
    "wrong-type",
}


@schemathesis.check
def only_meaning_is_refused(ctx, response, case):
    """A request that follows the description is refused for nothing that the description could have said."""
    is_valid = case.meta is not None and case.meta.generation.mode.is_positive
    if not is_valid or response.status_code != 422:
        return
    problem = response.json()
    faults = [fault for fault in problem.get("errors", []) if fault["code"] in FORM]
    if faults:
        raise AssertionError(f"valid data were refused for their form: {faults}")

//! What is offered to operators and not decided yet: one condition for all statements.

/// Whether a fit waits for an operator: it is offered, and nobody has decided.
macro_rules! waits {
    ($fit:literal) => {
        concat!(
            "EXISTS (SELECT 1 FROM offers o WHERE o.fit = ",
            $fit,
            ") AND NOT EXISTS (SELECT 1 FROM decisions w WHERE w.fit = ",
            $fit,
            ")"
        )
    };
}
pub(super) use waits;

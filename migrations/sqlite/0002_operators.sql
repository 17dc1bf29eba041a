-- What operators decide (held and suggested fits, pins), and what newer measurements say of the set in service.

-- Parameters that the gate let through but nobody has published: they wait for an operator.
CREATE TABLE offers (
    fit    TEXT PRIMARY KEY REFERENCES fits (id),
    served TEXT NOT NULL,
    state  TEXT
);
CREATE TRIGGER an_offer_needs_a_fit_that_passed BEFORE INSERT ON offers
WHEN NOT EXISTS (SELECT 1 FROM fits WHERE id = NEW.fit AND verdict IN ('accepted', 'held'))
BEGIN
    SELECT RAISE(ABORT, 'only a fit that was accepted or held can be offered');
END;

-- An operator's word on an offer. It is final.
CREATE TABLE decisions (
    fit        TEXT   PRIMARY KEY REFERENCES offers (fit),
    decision   TEXT   NOT NULL CHECK (decision IN ('promoted', 'rejected')),
    reason     TEXT   NOT NULL,
    decided_at BIGINT NOT NULL
);
CREATE TRIGGER a_decision_is_final BEFORE UPDATE ON decisions
BEGIN
    SELECT RAISE(ABORT, 'a decision does not change');
END;

-- How a revision came to be served: by the gate, by an operator's promotion, or by a pin.
ALTER TABLE revisions ADD COLUMN cause TEXT NOT NULL DEFAULT 'accepted' CHECK (cause IN ('accepted', 'promoted', 'pinned'));
ALTER TABLE revisions ADD COLUMN reason TEXT;
ALTER TABLE revisions ADD COLUMN published_at BIGINT;
UPDATE revisions SET published_at = fitted_at;

DROP TRIGGER a_revision_needs_an_accepted_fit;
CREATE TRIGGER a_revision_needs_an_accepted_fit BEFORE INSERT ON revisions
WHEN NOT EXISTS (
    SELECT 1 FROM fits f LEFT JOIN decisions d ON d.fit = f.id
    WHERE f.id = NEW.fit AND f.system = NEW.system AND (f.verdict = 'accepted' OR (f.verdict = 'held' AND d.decision = 'promoted')))
BEGIN
    SELECT RAISE(ABORT, 'a revision needs an accepted fit of its system, or a held one that an operator has promoted');
END;

-- Systems whose revision stays in service until an operator says otherwise.
CREATE TABLE pins (
    system    TEXT   PRIMARY KEY REFERENCES systems (system),
    revision  BIGINT NOT NULL,
    reason    TEXT   NOT NULL,
    since_at  BIGINT NOT NULL,
    FOREIGN KEY (system, revision) REFERENCES revisions (system, revision)
);

-- Systems whose revision forecasts newer measurements much worse than those that it was validated on.
CREATE TABLE degradations (
    system      TEXT   PRIMARY KEY REFERENCES systems (system),
    revision    BIGINT NOT NULL,
    description TEXT   NOT NULL,
    since_at    BIGINT NOT NULL,
    FOREIGN KEY (system, revision) REFERENCES revisions (system, revision)
);

-- The first schema. Every CHECK mirrors an enum of src/store; a row that Rust could not name cannot exist.
-- Instants are milliseconds since 1970-01-01T00:00:00Z (`…_at`), measurement times whole seconds (`…_s`).
-- Documents are JSON texts, kept as they were accepted.

-- Numbers that are handed out once: the boot that a lease names, and the order of everything else.
CREATE TABLE counters (
    name  TEXT   PRIMARY KEY CHECK (name IN ('boot', 'sequence')),
    value BIGINT NOT NULL CHECK (value >= 0)
);
INSERT INTO counters (name, value) VALUES ('boot', 0), ('sequence', 0);

-- Rooms and plants. `model` repeats a field of the document, because the end of a job asks for it inside
-- its transaction: only a fit of the system's own model counts.
CREATE TABLE systems (
    system     TEXT   PRIMARY KEY CHECK (system LIKE '_%/_%'),
    model      TEXT   NOT NULL,
    document   TEXT   NOT NULL,
    created_at BIGINT NOT NULL,
    updated_at BIGINT NOT NULL
);

-- Uploaded measurements. The id is a hash of system and content, so the same body twice is one window;
-- `sequence` is the order of upload: where windows overlap, the newest wins.
CREATE TABLE windows (
    id          TEXT   PRIMARY KEY CHECK (id LIKE 'win\_%' ESCAPE '\'),
    system      TEXT   NOT NULL REFERENCES systems (system),
    sequence    BIGINT NOT NULL UNIQUE,
    from_s      BIGINT NOT NULL,
    to_s        BIGINT NOT NULL CHECK (to_s >= from_s),
    report      TEXT   NOT NULL,
    uploaded_at BIGINT NOT NULL
);
CREATE INDEX windows_of_system ON windows (system, sequence);

-- One compressed block per channel and window; a row per sample would be a thousand times as many.
CREATE TABLE window_blocks (
    window  TEXT NOT NULL REFERENCES windows (id) ON DELETE CASCADE,
    channel TEXT NOT NULL,
    block   BLOB NOT NULL,
    PRIMARY KEY (window, channel)
);

-- Model and effect documents of users; the built-in ones are part of the binary.
CREATE TABLE models (
    id         TEXT   PRIMARY KEY,
    document   TEXT   NOT NULL,
    created_at BIGINT NOT NULL
);
CREATE TABLE effects (
    id         TEXT   PRIMARY KEY,
    document   TEXT   NOT NULL,
    created_at BIGINT NOT NULL
);

-- Models that somebody made by adding an effect: immutable, with a parent and a difference.
CREATE TABLE model_versions (
    id         TEXT   PRIMARY KEY,
    parent     TEXT   NOT NULL,
    effect     TEXT   NOT NULL,
    document   TEXT   NOT NULL,
    created_at BIGINT NOT NULL
);

-- The queue. A job is claimed by one UPDATE that also counts the attempt, so a job that kills the process
-- is counted too. `turn` is its place in a fair queue over systems; `priority` 0 is served first.
CREATE TABLE jobs (
    id          TEXT    PRIMARY KEY CHECK (id LIKE 'job\_%' ESCAPE '\'),
    sequence    BIGINT  NOT NULL UNIQUE,
    kind        TEXT    NOT NULL CHECK (kind IN ('estimate')),
    system      TEXT    NOT NULL REFERENCES systems (system),
    model       TEXT    NOT NULL,
    request     TEXT    NOT NULL,
    fingerprint TEXT    NOT NULL,
    experiment  BOOLEAN NOT NULL,
    origin      TEXT    NOT NULL CHECK (origin IN ('posted', 'scheduled')),
    priority    BIGINT  NOT NULL CHECK (priority IN (0, 1, 2)),
    turn        BIGINT  NOT NULL CHECK (turn >= 0),
    state       TEXT    NOT NULL CHECK (state IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    outcome     TEXT    CHECK (outcome IN ('accepted', 'held', 'rejected', 'suggested', 'unchanged')),
    boot        BIGINT,
    attempt     BIGINT  NOT NULL DEFAULT 0 CHECK (attempt BETWEEN 0 AND 3),
    requeued    BOOLEAN NOT NULL DEFAULT FALSE,
    cancelling  BOOLEAN NOT NULL DEFAULT FALSE,
    fit         TEXT,
    revision    BIGINT,
    error       TEXT,
    stopped_by  TEXT    CHECK (stopped_by IN ('converged', 'stalled', 'budget', 'deadline', 'cancelled', 'target')),
    evaluations BIGINT,
    created_at  BIGINT  NOT NULL,
    started_at  BIGINT,
    ended_at    BIGINT,
    -- What a state implies is in the row, and nothing else is.
    CHECK ((state = 'running') = (boot IS NOT NULL)),
    CHECK ((state = 'succeeded') = (outcome IS NOT NULL)),
    CHECK ((state = 'succeeded') = (fit IS NOT NULL)),
    CHECK ((state = 'failed') = (error IS NOT NULL)),
    CHECK ((state IN ('succeeded', 'failed', 'cancelled')) = (ended_at IS NOT NULL))
);
-- Equal jobs wait once. A job that came back after an interruption may wait beside an equal newer one.
CREATE UNIQUE INDEX one_waiting_equal_job ON jobs (fingerprint) WHERE state = 'queued' AND NOT requeued;
CREATE INDEX jobs_waiting ON jobs (priority, turn, sequence) WHERE state = 'queued';
CREATE INDEX jobs_turns ON jobs (system, priority, turn) WHERE state = 'queued';
CREATE INDEX jobs_running ON jobs (system) WHERE state = 'running';
CREATE INDEX jobs_of_system ON jobs (system, sequence);

-- A recalibration of several systems: ordinary jobs, and the systems that were left out, with the reason.
CREATE TABLE batches (
    id         TEXT   PRIMARY KEY CHECK (id LIKE 'bat\_%' ESCAPE '\'),
    sequence   BIGINT NOT NULL UNIQUE,
    kind       TEXT   NOT NULL CHECK (kind IN ('recalibrate')),
    schedule   TEXT,
    request    TEXT   NOT NULL,
    skipped    TEXT   NOT NULL,
    created_at BIGINT NOT NULL
);
CREATE TABLE batch_jobs (
    batch TEXT NOT NULL REFERENCES batches (id),
    job   TEXT NOT NULL REFERENCES jobs (id),
    PRIMARY KEY (batch, job)
);

-- Everything that was ever found, with its verdict.
CREATE TABLE fits (
    id         TEXT   PRIMARY KEY CHECK (id LIKE 'fit\_%' ESCAPE '\'),
    job        TEXT   NOT NULL UNIQUE REFERENCES jobs (id),
    system     TEXT   NOT NULL REFERENCES systems (system),
    model      TEXT   NOT NULL,
    document   TEXT   NOT NULL,
    verdict    TEXT   NOT NULL CHECK (verdict IN ('accepted', 'unchanged', 'held', 'rejected')),
    checks     TEXT   NOT NULL,
    summary    TEXT   NOT NULL,
    created_at BIGINT NOT NULL
);
CREATE TRIGGER a_verdict_is_final BEFORE UPDATE OF verdict, document ON fits
BEGIN
    SELECT RAISE(ABORT, 'a fit and its verdict do not change');
END;

-- What /params serves. Revisions of a system count up by one and never go back; exactly one is current.
CREATE TABLE revisions (
    system       TEXT    NOT NULL REFERENCES systems (system),
    revision     BIGINT  NOT NULL CHECK (revision >= 1),
    fit          TEXT    NOT NULL REFERENCES fits (id),
    job          TEXT    NOT NULL REFERENCES jobs (id),
    served       TEXT    NOT NULL,
    served_hash  TEXT    NOT NULL,
    model_hash   TEXT    NOT NULL,
    window_from  TEXT    NOT NULL,
    window_to    TEXT    NOT NULL,
    current      BOOLEAN NOT NULL,
    fitted_at    BIGINT  NOT NULL,
    validated_at BIGINT  NOT NULL,
    PRIMARY KEY (system, revision)
);
CREATE UNIQUE INDEX one_current_revision ON revisions (system) WHERE current;
CREATE TRIGGER a_revision_needs_an_accepted_fit BEFORE INSERT ON revisions
WHEN NOT EXISTS (SELECT 1 FROM fits WHERE id = NEW.fit AND system = NEW.system AND verdict = 'accepted')
BEGIN
    SELECT RAISE(ABORT, 'a revision needs an accepted fit of its system');
END;
CREATE TRIGGER revisions_count_up BEFORE INSERT ON revisions
WHEN NEW.revision <> 1 + COALESCE((SELECT MAX(revision) FROM revisions WHERE system = NEW.system), 0)
BEGIN
    SELECT RAISE(ABORT, 'revisions count up by one');
END;
CREATE TRIGGER a_revision_does_not_change BEFORE UPDATE OF system, revision, fit, served, served_hash ON revisions
BEGIN
    SELECT RAISE(ABORT, 'a revision does not change');
END;

-- Systems whose newest own attempt failed: the previous revision stays served and the answer says why.
CREATE TABLE fallbacks (
    system        TEXT   PRIMARY KEY REFERENCES systems (system),
    reason        TEXT   NOT NULL CHECK (reason IN ('validation_failed', 'job_failed')),
    job           TEXT   NOT NULL REFERENCES jobs (id),
    fit           TEXT   REFERENCES fits (id),
    failed_checks TEXT   NOT NULL,
    since_at      BIGINT NOT NULL,
    CHECK ((reason = 'validation_failed') = (fit IS NOT NULL))
);

-- The filtered states at the newest sample, by the parameters that are served.
CREATE TABLE states (
    system   TEXT   PRIMARY KEY REFERENCES systems (system),
    revision BIGINT NOT NULL,
    document TEXT   NOT NULL,
    FOREIGN KEY (system, revision) REFERENCES revisions (system, revision)
);

-- The row is the schedule. `last_tick_at` is the newest tick that was dealt with, run or not.
CREATE TABLE schedules (
    name         TEXT    PRIMARY KEY,
    cron         TEXT    NOT NULL,
    zone         TEXT    NOT NULL,
    request      TEXT    NOT NULL,
    enabled      BOOLEAN NOT NULL,
    last_tick_at BIGINT  NOT NULL,
    last_run_at  BIGINT,
    last_batch   TEXT    REFERENCES batches (id),
    last_result  TEXT    CHECK (last_result IN ('submitted', 'skipped_overlap', 'nothing_to_do')),
    updated_at   BIGINT  NOT NULL
);

-- Keys of requests that created something: the same key again gets the same answer, not a second thing.
CREATE TABLE idempotency (
    key         TEXT   PRIMARY KEY,
    fingerprint TEXT   NOT NULL,
    resource    TEXT   NOT NULL,
    status      BIGINT NOT NULL,
    created_at  BIGINT NOT NULL
);
CREATE INDEX idempotency_by_age ON idempotency (created_at);

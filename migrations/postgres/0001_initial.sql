-- The schema of a database that several services share. What the tables hold is told where SQLite's are made
-- (`../sqlite`); every CHECK mirrors an enum of src/store. Names are in the order of their bytes, as on SQLite.

-- Functions that SQLite has, for one text of the statements.

-- The elements of a list.
CREATE FUNCTION json_each(document TEXT) RETURNS TABLE (key TEXT, value TEXT)
LANGUAGE sql IMMUTABLE PARALLEL SAFE AS $$
    SELECT (e.place - 1)::TEXT, e.element FROM json_array_elements_text(document::JSON) WITH ORDINALITY e (element, place)
$$;

-- What lies at a path such as `$.metrics` or `$[0]`: the text of a text, the document of anything else.
CREATE FUNCTION json_extract(document TEXT, path TEXT) RETURNS TEXT LANGUAGE sql IMMUTABLE PARALLEL SAFE AS $$
    SELECT document::JSON #>> string_to_array(ltrim(replace(replace(path, '[', '.'), ']', ''), '$.'), '.')
$$;

-- The elements of a list or an object at a path; none where there is nothing.
CREATE FUNCTION json_each(document TEXT, path TEXT) RETURNS TABLE (key TEXT, value TEXT)
LANGUAGE plpgsql IMMUTABLE PARALLEL SAFE AS $$
DECLARE
    part JSON := document::JSON #> string_to_array(ltrim(path, '$.'), '.');
BEGIN
    IF json_typeof(part) = 'array' THEN
        RETURN QUERY SELECT * FROM json_each(part::TEXT);
    ELSIF json_typeof(part) = 'object' THEN
        RETURN QUERY SELECT * FROM json_each_text(part);
    END IF;
END $$;

-- Whether a pattern, whose only sign is `*`, fits a name.
CREATE FUNCTION glob(pattern TEXT, name TEXT) RETURNS BOOLEAN LANGUAGE sql IMMUTABLE PARALLEL SAFE AS $$
    SELECT name LIKE replace(replace(replace(pattern, '\', '\\'), '_', '\_'), '*', '%')
$$;

CREATE FUNCTION max(a BIGINT, b BIGINT) RETURNS BIGINT LANGUAGE sql IMMUTABLE PARALLEL SAFE AS 'SELECT greatest(a, b)';
CREATE FUNCTION min(a BIGINT, b BIGINT) RETURNS BIGINT LANGUAGE sql IMMUTABLE PARALLEL SAFE AS 'SELECT least(a, b)';
CREATE FUNCTION max(a TEXT, b TEXT) RETURNS TEXT LANGUAGE sql IMMUTABLE PARALLEL SAFE AS
    'SELECT greatest(a COLLATE "C", b COLLATE "C")';

-- What a transaction that must be alone locks. It is empty.
CREATE TABLE writing ();

CREATE TABLE counters (
    name TEXT COLLATE "C" PRIMARY KEY CHECK (name IN ('boot', 'sequence', 'change', 'claim')),
    value BIGINT NOT NULL CHECK (value >= 0)
);

CREATE TABLE systems (
    system TEXT COLLATE "C" PRIMARY KEY CHECK (system LIKE '_%/_%'),
    model TEXT COLLATE "C" NOT NULL,
    document TEXT COLLATE "C" NOT NULL,
    created_at BIGINT NOT NULL,
    updated_at BIGINT NOT NULL,
    tenant TEXT COLLATE "C" NOT NULL DEFAULT ''
);

CREATE TABLE windows (
    id TEXT COLLATE "C" PRIMARY KEY CHECK (id LIKE 'win\_%' ESCAPE '\'),
    system TEXT COLLATE "C" NOT NULL REFERENCES systems (system),
    sequence BIGINT NOT NULL UNIQUE,
    from_ms BIGINT NOT NULL,
    to_ms BIGINT NOT NULL CHECK (to_ms >= from_ms),
    report BYTEA NOT NULL,
    uploaded_at BIGINT NOT NULL,
    uploads BIGINT NOT NULL DEFAULT 1 CHECK (uploads >= 1),
    day BIGINT
);

CREATE TABLE shares (
    window_id TEXT COLLATE "C" NOT NULL,
    day BIGINT NOT NULL,
    channels TEXT COLLATE "C" NOT NULL,
    block BYTEA NOT NULL,
    PRIMARY KEY (window_id, day)
) PARTITION BY RANGE (day);

CREATE TABLE models (
    id TEXT COLLATE "C" PRIMARY KEY,
    document TEXT COLLATE "C" NOT NULL,
    created_at BIGINT NOT NULL
);

CREATE TABLE effects (
    id TEXT COLLATE "C" PRIMARY KEY,
    document TEXT COLLATE "C" NOT NULL,
    created_at BIGINT NOT NULL
);

CREATE TABLE model_versions (
    id TEXT COLLATE "C" PRIMARY KEY,
    parent TEXT COLLATE "C" NOT NULL,
    effect TEXT COLLATE "C" NOT NULL,
    document TEXT COLLATE "C" NOT NULL,
    created_at BIGINT NOT NULL
);

CREATE TABLE jobs (
    id TEXT COLLATE "C" PRIMARY KEY CHECK (id LIKE 'job\_%' ESCAPE '\'),
    sequence BIGINT NOT NULL UNIQUE,
    kind TEXT COLLATE "C" NOT NULL CHECK (kind IN ('estimate', 'diagnose', 'ladder', 'tune')),
    system TEXT COLLATE "C" NOT NULL REFERENCES systems (system),
    model TEXT COLLATE "C" NOT NULL,
    request TEXT COLLATE "C" NOT NULL,
    fingerprint TEXT COLLATE "C" NOT NULL,
    experiment BOOLEAN NOT NULL,
    origin TEXT COLLATE "C" NOT NULL CHECK (origin IN ('posted', 'scheduled')),
    priority BIGINT NOT NULL CHECK (priority IN (0, 1, 2)),
    turn BIGINT NOT NULL CHECK (turn >= 0),
    state TEXT COLLATE "C" NOT NULL CHECK (state IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    outcome TEXT COLLATE "C" CHECK (outcome IN ('accepted', 'held', 'rejected', 'suggested', 'unchanged')),
    boot BIGINT,
    attempt BIGINT NOT NULL DEFAULT 0 CHECK (attempt BETWEEN 0 AND 3),
    requeued BOOLEAN NOT NULL DEFAULT FALSE,
    cancelling BOOLEAN NOT NULL DEFAULT FALSE,
    fit TEXT COLLATE "C",
    revision BIGINT,
    error TEXT COLLATE "C",
    stopped_by TEXT COLLATE "C" CHECK (stopped_by IN ('converged', 'stalled', 'budget', 'deadline', 'cancelled', 'target')),
    evaluations BIGINT,
    created_at BIGINT NOT NULL,
    started_at BIGINT,
    ended_at BIGINT,
    retry_of TEXT COLLATE "C" REFERENCES jobs (id) DEFERRABLE,
    end_sequence BIGINT,
    diagnosis TEXT COLLATE "C",
    tuning TEXT COLLATE "C",
    tenant TEXT COLLATE "C" NOT NULL DEFAULT '',
    CHECK ((state = 'running') = (boot IS NOT NULL)),
    CHECK ((state = 'succeeded' AND kind IN ('estimate', 'tune')) = (outcome IS NOT NULL)),
    CHECK ((state = 'succeeded' AND kind <> 'tune') = (fit IS NOT NULL)),
    CHECK ((state = 'failed') = (error IS NOT NULL)),
    CHECK ((state IN ('succeeded', 'failed', 'cancelled')) = (ended_at IS NOT NULL))
);

CREATE TABLE batches (
    id TEXT COLLATE "C" PRIMARY KEY CHECK (id LIKE 'bat\_%' ESCAPE '\'),
    sequence BIGINT NOT NULL UNIQUE,
    kind TEXT COLLATE "C" NOT NULL CHECK (kind IN ('recalibrate', 'diagnose')),
    schedule TEXT COLLATE "C",
    request TEXT COLLATE "C" NOT NULL,
    skipped TEXT COLLATE "C" NOT NULL,
    created_at BIGINT NOT NULL,
    waiting BYTEA,
    entered BIGINT NOT NULL DEFAULT 0
);

CREATE TABLE batch_jobs (
    batch TEXT COLLATE "C" NOT NULL REFERENCES batches (id),
    job TEXT COLLATE "C" NOT NULL REFERENCES jobs (id),
    PRIMARY KEY (batch, job)
);

CREATE TABLE fits (
    id TEXT COLLATE "C" PRIMARY KEY CHECK (id LIKE 'fit\_%' ESCAPE '\'),
    job TEXT COLLATE "C" NOT NULL UNIQUE REFERENCES jobs (id),
    system TEXT COLLATE "C" NOT NULL REFERENCES systems (system),
    model TEXT COLLATE "C" NOT NULL,
    document BYTEA NOT NULL,
    replay BYTEA,
    verdict TEXT COLLATE "C" NOT NULL CHECK (verdict IN ('accepted', 'unchanged', 'held', 'rejected')),
    checks BYTEA NOT NULL,
    summary TEXT COLLATE "C" NOT NULL,
    created_at BIGINT NOT NULL,
    rowid BIGINT GENERATED ALWAYS AS IDENTITY UNIQUE
);

CREATE TABLE revisions (
    system TEXT COLLATE "C" NOT NULL REFERENCES systems (system),
    revision BIGINT NOT NULL CHECK (revision >= 1),
    fit TEXT COLLATE "C" NOT NULL REFERENCES fits (id),
    job TEXT COLLATE "C" NOT NULL REFERENCES jobs (id),
    served TEXT COLLATE "C" NOT NULL,
    served_hash TEXT COLLATE "C" NOT NULL,
    model_hash TEXT COLLATE "C" NOT NULL,
    window_from TEXT COLLATE "C" NOT NULL,
    window_to TEXT COLLATE "C" NOT NULL,
    current BOOLEAN NOT NULL,
    fitted_at BIGINT NOT NULL,
    validated_at BIGINT NOT NULL,
    cause TEXT COLLATE "C" NOT NULL DEFAULT 'accepted' CHECK (cause IN ('accepted', 'promoted', 'pinned')),
    reason TEXT COLLATE "C",
    published_at BIGINT,
    measured_to TEXT COLLATE "C",
    PRIMARY KEY (system, revision)
);

CREATE TABLE fallbacks (
    system TEXT COLLATE "C" PRIMARY KEY REFERENCES systems (system),
    reason TEXT COLLATE "C" NOT NULL CHECK (reason IN ('validation_failed', 'job_failed')),
    job TEXT COLLATE "C" NOT NULL REFERENCES jobs (id),
    fit TEXT COLLATE "C" REFERENCES fits (id),
    failed_checks TEXT COLLATE "C" NOT NULL,
    since_at BIGINT NOT NULL,
    CHECK ((reason = 'validation_failed') = (fit IS NOT NULL))
);

CREATE TABLE states (
    system TEXT COLLATE "C" PRIMARY KEY REFERENCES systems (system),
    revision BIGINT NOT NULL,
    document TEXT COLLATE "C" NOT NULL,
    FOREIGN KEY (system, revision) REFERENCES revisions (system, revision)
);

CREATE TABLE schedules (
    name TEXT COLLATE "C" PRIMARY KEY,
    cron TEXT COLLATE "C" NOT NULL,
    zone TEXT COLLATE "C" NOT NULL,
    request TEXT COLLATE "C" NOT NULL,
    enabled BOOLEAN NOT NULL,
    last_tick_at BIGINT NOT NULL,
    last_run_at BIGINT,
    last_batch TEXT COLLATE "C" REFERENCES batches (id),
    last_result TEXT COLLATE "C" CHECK (last_result IN ('submitted', 'skipped_overlap', 'nothing_to_do')),
    updated_at BIGINT NOT NULL
);

CREATE TABLE idempotency (
    key TEXT COLLATE "C" PRIMARY KEY,
    fingerprint TEXT COLLATE "C" NOT NULL,
    resource TEXT COLLATE "C" NOT NULL,
    status BIGINT NOT NULL,
    created_at BIGINT NOT NULL
);

CREATE TABLE offers (
    fit TEXT COLLATE "C" PRIMARY KEY REFERENCES fits (id),
    served TEXT COLLATE "C" NOT NULL,
    state TEXT COLLATE "C"
);

CREATE TABLE decisions (
    fit TEXT COLLATE "C" PRIMARY KEY REFERENCES offers (fit),
    decision TEXT COLLATE "C" NOT NULL CHECK (decision IN ('promoted', 'rejected')),
    reason TEXT COLLATE "C" NOT NULL,
    decided_at BIGINT NOT NULL
);

CREATE TABLE pins (
    system TEXT COLLATE "C" PRIMARY KEY REFERENCES systems (system),
    revision BIGINT NOT NULL,
    reason TEXT COLLATE "C" NOT NULL,
    since_at BIGINT NOT NULL,
    FOREIGN KEY (system, revision) REFERENCES revisions (system, revision)
);

CREATE TABLE degradations (
    system TEXT COLLATE "C" PRIMARY KEY REFERENCES systems (system),
    revision BIGINT NOT NULL,
    description TEXT COLLATE "C" NOT NULL,
    since_at BIGINT NOT NULL,
    FOREIGN KEY (system, revision) REFERENCES revisions (system, revision)
);

CREATE TABLE fit_windows (
    fit TEXT COLLATE "C" NOT NULL REFERENCES fits (id) ON DELETE CASCADE,
    window_id TEXT COLLATE "C" NOT NULL REFERENCES windows (id),
    PRIMARY KEY (fit, window_id)
);

CREATE TABLE diagnoses (
    id TEXT COLLATE "C" PRIMARY KEY CHECK (id LIKE 'dia\_%' ESCAPE '\'),
    sequence BIGINT NOT NULL UNIQUE,
    job TEXT COLLATE "C" NOT NULL UNIQUE REFERENCES jobs (id),
    system TEXT COLLATE "C" NOT NULL REFERENCES systems (system),
    fit TEXT COLLATE "C" NOT NULL REFERENCES fits (id),
    verdict TEXT COLLATE "C" NOT NULL CHECK (verdict IN ('named', 'adequate', 'unknown', 'not_enough_data')),
    document TEXT COLLATE "C" NOT NULL,
    created_at BIGINT NOT NULL
);

CREATE TABLE ladders (
    job TEXT COLLATE "C" PRIMARY KEY REFERENCES jobs (id),
    sequence BIGINT NOT NULL UNIQUE,
    system TEXT COLLATE "C" NOT NULL REFERENCES systems (system),
    fit TEXT COLLATE "C" NOT NULL REFERENCES fits (id),
    document TEXT COLLATE "C" NOT NULL,
    created_at BIGINT NOT NULL
);

CREATE TABLE tokens (
    name TEXT COLLATE "C" PRIMARY KEY CHECK (length(name) BETWEEN 1 AND 64),
    hash BYTEA NOT NULL UNIQUE CHECK (length(hash) = 32),
    scope TEXT COLLATE "C" NOT NULL CHECK (scope IN ('read', 'operate', 'admin')),
    systems TEXT COLLATE "C" CHECK (systems IS NULL OR scope <> 'admin'),
    created_at BIGINT NOT NULL,
    expires_at BIGINT,
    revoked_at BIGINT
);

CREATE TABLE audit (
    sequence BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    at BIGINT NOT NULL,
    who TEXT COLLATE "C" NOT NULL,
    action TEXT COLLATE "C" NOT NULL CHECK (action IN ( 'promote_fit', 'reject_fit', 'pin', 'unpin', 'put_system', 'delete_system', 'delete_window', 'put_schedule', 'delete_schedule', 'post_model', 'post_effect', 'create_token', 'revoke_token')),
    system TEXT COLLATE "C",
    subject TEXT COLLATE "C" NOT NULL,
    reason TEXT COLLATE "C"
);

CREATE TABLE evidence (
    diagnosis TEXT COLLATE "C" NOT NULL CHECK (diagnosis LIKE 'dia\_%' ESCAPE '\'),
    effect TEXT COLLATE "C" NOT NULL,
    sequence BIGINT NOT NULL,
    system TEXT COLLATE "C" NOT NULL REFERENCES systems (system),
    model TEXT COLLATE "C" NOT NULL,
    model_hash TEXT COLLATE "C",
    from_ms BIGINT NOT NULL,
    to_ms BIGINT NOT NULL,
    hours DOUBLE PRECISION NOT NULL,
    size DOUBLE PRECISION NOT NULL,
    deviation DOUBLE PRECISION NOT NULL,
    unit TEXT COLLATE "C" NOT NULL,
    share DOUBLE PRECISION NOT NULL,
    t DOUBLE PRECISION NOT NULL,
    beyond_clock DOUBLE PRECISION NOT NULL,
    days BIGINT NOT NULL,
    shift_p DOUBLE PRECISION,
    PRIMARY KEY (diagnosis, effect)
);

CREATE TABLE days (
    system TEXT COLLATE "C" NOT NULL,
    day BIGINT NOT NULL,
    from_ms BIGINT NOT NULL,
    to_ms BIGINT NOT NULL CHECK (to_ms >= from_ms),
    channels TEXT COLLATE "C" NOT NULL,
    block BYTEA NOT NULL,
    PRIMARY KEY (system, day)
) PARTITION BY RANGE (day);

-- What is compressed already is not tried to be compressed.
ALTER TABLE days ALTER COLUMN block SET STORAGE EXTERNAL;
ALTER TABLE shares ALTER COLUMN block SET STORAGE EXTERNAL;
ALTER TABLE windows ALTER COLUMN report SET STORAGE EXTERNAL;
ALTER TABLE fits ALTER COLUMN document SET STORAGE EXTERNAL, ALTER COLUMN replay SET STORAGE EXTERNAL,
    ALTER COLUMN checks SET STORAGE EXTERNAL;

-- Makes a month of a table that is kept by months, from one day to before another, if it is not there. It is made apart
-- and attached, which holds nobody up who reads or writes.
CREATE FUNCTION keep_month(parent TEXT, name TEXT, first BIGINT, next BIGINT) RETURNS VOID LANGUAGE plpgsql AS $$
BEGIN
    IF to_regclass(name) IS NULL THEN
        EXECUTE format('CREATE TABLE %I (LIKE %I INCLUDING ALL)', name, parent);
        EXECUTE format('ALTER TABLE %I ATTACH PARTITION %I FOR VALUES FROM (%s) TO (%s)', parent, name,
            COALESCE(first::TEXT, 'MINVALUE'), next);
    END IF;
END $$;

CREATE TABLE measured (
    system TEXT COLLATE "C" PRIMARY KEY REFERENCES systems (system),
    version BIGINT NOT NULL
);

CREATE TABLE window_aliases (
    id TEXT COLLATE "C" PRIMARY KEY CHECK (id LIKE 'win\_%' ESCAPE '\'),
    sequence BIGINT NOT NULL REFERENCES windows (sequence) ON DELETE CASCADE
);

CREATE TABLE retired (
    system TEXT COLLATE "C" PRIMARY KEY,
    revision BIGINT NOT NULL CHECK (revision > 0)
);

CREATE TABLE samples (
    sequence BIGINT PRIMARY KEY,
    system TEXT COLLATE "C" NOT NULL REFERENCES systems (system),
    window_id TEXT COLLATE "C" NOT NULL REFERENCES windows (id) ON DELETE CASCADE,
    from_ms BIGINT NOT NULL,
    to_ms BIGINT NOT NULL CHECK (to_ms >= from_ms),
    rows TEXT COLLATE "C" NOT NULL,
    came_at BIGINT NOT NULL
);

CREATE TABLE forecast_inputs (
    system TEXT COLLATE "C" NOT NULL REFERENCES systems (system),
    channel TEXT COLLATE "C" NOT NULL,
    issued_at BIGINT NOT NULL,
    version BIGINT NOT NULL,
    from_ms BIGINT NOT NULL,
    to_ms BIGINT NOT NULL CHECK (to_ms >= from_ms),
    block BYTEA NOT NULL,
    PRIMARY KEY (system, channel)
);

CREATE TABLE said_forecasts (
    system TEXT COLLATE "C" NOT NULL REFERENCES systems (system),
    output TEXT COLLATE "C" NOT NULL,
    quarter BIGINT NOT NULL,
    made_at BIGINT NOT NULL,
    revision BIGINT NOT NULL,
    at_ms BIGINT NOT NULL,
    said BYTEA NOT NULL,
    sd BYTEA NOT NULL,
    PRIMARY KEY (system, output, quarter)
);

CREATE TABLE sources (
    name TEXT COLLATE "C" PRIMARY KEY,
    document TEXT COLLATE "C" NOT NULL,
    changed_by TEXT COLLATE "C" NOT NULL,
    changed_at BIGINT NOT NULL
);

CREATE TABLE tenants (
    tenant TEXT COLLATE "C" PRIMARY KEY,
    started BIGINT NOT NULL,
    ended BIGINT NOT NULL CHECK (ended >= started)
);
ALTER TABLE jobs ADD FOREIGN KEY (diagnosis) REFERENCES diagnoses (id) DEFERRABLE;
INSERT INTO counters (name, value) VALUES ('boot', 0), ('sequence', 0), ('change', 0), ('claim', 0);

CREATE INDEX aliases_of_window ON window_aliases (sequence);
CREATE INDEX audit_of_system ON audit (system, sequence);
CREATE INDEX batches_to_enter ON batches (sequence) WHERE waiting IS NOT NULL;
CREATE INDEX batches_of_job ON batch_jobs (job);
CREATE INDEX diagnoses_of_fit ON diagnoses (fit);
CREATE INDEX diagnoses_of_system ON diagnoses (system, sequence);
CREATE INDEX evidence_of_system ON evidence (system, sequence);
CREATE INDEX fits_of_system ON fits (system);
CREATE INDEX fits_to_shorten ON fits (created_at) WHERE replay IS NOT NULL;
CREATE INDEX fits_of_window ON fit_windows (window_id);
CREATE INDEX idempotency_by_age ON idempotency (created_at);
CREATE INDEX jobs_cancelled ON jobs (sequence) WHERE state = 'cancelled';
CREATE INDEX jobs_ended ON jobs (end_sequence);
CREATE INDEX jobs_failed ON jobs (sequence) WHERE state = 'failed';
CREATE INDEX jobs_of_diagnosis ON jobs (diagnosis) WHERE diagnosis IS NOT NULL;
CREATE INDEX jobs_of_kind ON jobs (kind, sequence);
CREATE INDEX jobs_of_system ON jobs (system, sequence);
CREATE INDEX jobs_queued ON jobs (sequence) WHERE state = 'queued';
CREATE INDEX jobs_repeated ON jobs (retry_of) WHERE retry_of IS NOT NULL;
CREATE INDEX jobs_succeeded ON jobs (sequence) WHERE state = 'succeeded';
CREATE INDEX jobs_turns ON jobs (system, priority, turn) WHERE state = 'queued';
CREATE INDEX jobs_waiting ON jobs (tenant, priority, turn, sequence) WHERE state = 'queued';
CREATE INDEX ladders_of_fit ON ladders (fit);
CREATE INDEX ladders_of_system ON ladders (system, sequence);
CREATE UNIQUE INDEX one_current_revision ON revisions (system) WHERE current;
CREATE UNIQUE INDEX one_running_job_of_a_system ON jobs (system) WHERE state = 'running';
CREATE UNIQUE INDEX one_waiting_equal_job ON jobs (fingerprint) WHERE state = 'queued' AND NOT requeued;
CREATE INDEX revisions_of_fit ON revisions (fit);
CREATE INDEX revisions_of_job ON revisions (job);
CREATE INDEX said_by_age ON said_forecasts (made_at);
CREATE INDEX samples_of_system ON samples (system, sequence);
CREATE INDEX samples_of_window ON samples (window_id);
CREATE INDEX tenants_in_turn ON tenants (ended, tenant);
CREATE INDEX windows_of_system ON windows (system, sequence);

-- The processes that work, each by a row for one start of it, with a lease by the clock of this server.
CREATE TABLE workers (
    worker BIGINT PRIMARY KEY,
    name TEXT COLLATE "C" NOT NULL,
    roles TEXT COLLATE "C" NOT NULL,
    started_at BIGINT NOT NULL,
    until BIGINT NOT NULL
);
CREATE VIEW clock AS SELECT (extract(epoch FROM clock_timestamp()) * 1000)::BIGINT AS ms;
CREATE INDEX jobs_cancelling ON jobs (boot) WHERE state = 'running' AND cancelling;

-- What every service follows: of which systems something has changed that is served, or is said of what is served
-- (`system`), what else was measured of them (`measured`), that there are other documents (`catalogue`) or schedules
-- (`schedule`), that a job has come back to the queue (`queue`). Commits overtake one another, so a row has its place in their order when somebody gives it one
-- behind its commit (`feed`).
CREATE TABLE changes (
    id BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    xact XID8 NOT NULL DEFAULT pg_current_xact_id(),
    topic TEXT COLLATE "C" NOT NULL CHECK (topic IN ('system', 'measured', 'catalogue', 'schedule', 'queue')),
    name TEXT COLLATE "C" NOT NULL,
    position BIGINT UNIQUE
);
CREATE UNIQUE INDEX changes_of_transaction ON changes (xact, topic, name);
CREATE INDEX changes_without_place ON changes (id) WHERE position IS NULL;

CREATE FUNCTION note(of TEXT, name TEXT) RETURNS VOID LANGUAGE sql AS $$
    INSERT INTO changes (topic, name) VALUES (of, name) ON CONFLICT DO NOTHING
$$;

CREATE FUNCTION note_system() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    PERFORM note('system', CASE WHEN TG_OP = 'DELETE' THEN OLD.system ELSE NEW.system END);
    RETURN NULL;
END $$;
CREATE FUNCTION note_measured() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    PERFORM note('measured', NEW.system);
    RETURN NULL;
END $$;
CREATE TRIGGER measurements_came AFTER INSERT OR UPDATE ON measured
    FOR EACH ROW EXECUTE FUNCTION note_measured();
CREATE FUNCTION note_document() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    PERFORM note('catalogue', NEW.id);
    RETURN NULL;
END $$;
CREATE TRIGGER a_document_came AFTER INSERT ON models FOR EACH ROW EXECUTE FUNCTION note_document();
CREATE TRIGGER a_document_came AFTER INSERT ON effects FOR EACH ROW EXECUTE FUNCTION note_document();
CREATE TRIGGER a_document_came AFTER INSERT ON model_versions FOR EACH ROW EXECUTE FUNCTION note_document();
CREATE FUNCTION note_schedule() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    PERFORM note('schedule', CASE WHEN TG_OP = 'DELETE' THEN OLD.name ELSE NEW.name END);
    RETURN NULL;
END $$;
CREATE TRIGGER a_schedule_changed AFTER INSERT OR UPDATE OR DELETE ON schedules
    FOR EACH ROW EXECUTE FUNCTION note_schedule();

CREATE TRIGGER what_is_said_changes AFTER INSERT OR UPDATE OR DELETE ON systems
    FOR EACH ROW EXECUTE FUNCTION note_system();
CREATE TRIGGER what_is_said_changes AFTER INSERT OR UPDATE OR DELETE ON fallbacks
    FOR EACH ROW EXECUTE FUNCTION note_system();
CREATE TRIGGER what_is_said_changes AFTER INSERT OR UPDATE OR DELETE ON pins
    FOR EACH ROW EXECUTE FUNCTION note_system();
CREATE TRIGGER what_is_said_changes AFTER INSERT OR UPDATE OR DELETE ON degradations
    FOR EACH ROW EXECUTE FUNCTION note_system();
CREATE TRIGGER what_is_said_changes AFTER INSERT OR UPDATE ON revisions
    FOR EACH ROW EXECUTE FUNCTION note_system();
CREATE TRIGGER states_came AFTER INSERT ON states
    FOR EACH ROW EXECUTE FUNCTION note_system();
CREATE TRIGGER states_changed AFTER UPDATE ON states FOR EACH ROW
    WHEN (OLD.revision <> NEW.revision OR OLD.document <> NEW.document) EXECUTE FUNCTION note_system();

-- Of jobs, only which one is the newest and where it stands, which is told of systems that serve nothing yet.
CREATE FUNCTION note_job() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    IF NOT EXISTS (SELECT 1 FROM revisions WHERE system = NEW.system) THEN
        PERFORM note('system', NEW.system);
    END IF;
    RETURN NULL;
END $$;
CREATE FUNCTION note_return() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    PERFORM note('queue', NEW.system);
    RETURN NULL;
END $$;
CREATE TRIGGER a_job_came_back AFTER UPDATE OF state ON jobs FOR EACH ROW
    WHEN (NEW.state = 'queued' AND OLD.state = 'running') EXECUTE FUNCTION note_return();
CREATE TRIGGER a_job_came AFTER INSERT ON jobs FOR EACH ROW EXECUTE FUNCTION note_job();
CREATE TRIGGER a_job_stands_elsewhere AFTER UPDATE OF state ON jobs
    FOR EACH ROW EXECUTE FUNCTION note_job();

-- Whoever ends a job, its end is numbered in the same transaction.
CREATE FUNCTION number_end() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    UPDATE counters SET value = value + 1 WHERE name = 'sequence' RETURNING value INTO NEW.end_sequence;
    RETURN NEW;
END $$;
CREATE TRIGGER an_end_is_numbered BEFORE UPDATE OF state ON jobs FOR EACH ROW
    WHEN (NEW.ended_at IS NOT NULL AND OLD.ended_at IS NULL) EXECUTE FUNCTION number_end();

-- What does not change.
CREATE FUNCTION refuse() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    RAISE EXCEPTION '%', TG_ARGV[0];
END $$;
CREATE TRIGGER a_verdict_is_final BEFORE UPDATE OF verdict, document ON fits
    FOR EACH ROW EXECUTE FUNCTION refuse('a fit and its verdict do not change');
CREATE TRIGGER a_revision_does_not_change BEFORE UPDATE OF system, revision, fit, served, served_hash ON revisions
    FOR EACH ROW EXECUTE FUNCTION refuse('a revision does not change');
CREATE TRIGGER a_decision_is_final BEFORE UPDATE ON decisions
    FOR EACH ROW EXECUTE FUNCTION refuse('a decision does not change');
CREATE TRIGGER a_token_does_not_change BEFORE UPDATE ON tokens FOR EACH ROW
    WHEN (OLD.revoked_at IS NOT NULL OR NEW.name <> OLD.name OR NEW.hash <> OLD.hash OR NEW.scope <> OLD.scope
        OR NEW.systems IS DISTINCT FROM OLD.systems OR NEW.created_at <> OLD.created_at
        OR NEW.expires_at IS DISTINCT FROM OLD.expires_at)
    EXECUTE FUNCTION refuse('a token can be revoked and nothing else');
CREATE TRIGGER a_token_is_not_forgotten BEFORE DELETE ON tokens
    FOR EACH ROW EXECUTE FUNCTION refuse('a token can be revoked and nothing else');
CREATE TRIGGER what_was_done_does_not_change BEFORE UPDATE ON audit
    FOR EACH ROW EXECUTE FUNCTION refuse('what was done does not change');
CREATE TRIGGER what_was_done_is_not_forgotten BEFORE DELETE ON audit
    FOR EACH ROW EXECUTE FUNCTION refuse('what was done is not forgotten');

CREATE FUNCTION require_offered_fit() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    IF NOT EXISTS (SELECT 1 FROM fits WHERE id = NEW.fit AND verdict IN ('accepted', 'held')) THEN
        RAISE EXCEPTION 'only a fit that was accepted or held can be offered';
    END IF;
    RETURN NEW;
END $$;
CREATE TRIGGER an_offer_needs_a_fit_that_passed BEFORE INSERT ON offers
    FOR EACH ROW EXECUTE FUNCTION require_offered_fit();

CREATE FUNCTION require_accepted_fit() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    IF NOT EXISTS (
        SELECT 1 FROM fits f LEFT JOIN decisions d ON d.fit = f.id WHERE f.id = NEW.fit AND f.system = NEW.system
        AND (f.verdict = 'accepted' OR (f.verdict = 'held' AND d.decision = 'promoted'))) THEN
        RAISE EXCEPTION 'a revision needs an accepted fit of its system, or a held one that an operator has promoted';
    END IF;
    IF NEW.revision <> 1 + greatest(
        COALESCE((SELECT max(revision) FROM revisions WHERE system = NEW.system), 0),
        COALESCE((SELECT revision FROM retired WHERE system = NEW.system), 0)) THEN
        RAISE EXCEPTION 'revisions count up by one';
    END IF;
    RETURN NEW;
END $$;
CREATE TRIGGER a_revision_needs_an_accepted_fit BEFORE INSERT ON revisions
    FOR EACH ROW EXECUTE FUNCTION require_accepted_fit();

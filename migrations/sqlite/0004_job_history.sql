-- What listeners and operators want to know of a job beside its state.

-- The job that this one repeats.
ALTER TABLE jobs ADD COLUMN retry_of TEXT REFERENCES jobs (id);

-- The place of a job's end in the order of everything. Listeners that come back name the last number that they
-- have seen, so no end is lost to them, also not over a restart; a time would not do, because clocks jump.
ALTER TABLE jobs ADD COLUMN end_sequence BIGINT;
CREATE INDEX jobs_ended ON jobs (end_sequence);
-- Whoever ends a job, its end is numbered in the same transaction.
CREATE TRIGGER an_end_is_numbered AFTER UPDATE OF state ON jobs
WHEN NEW.ended_at IS NOT NULL AND OLD.ended_at IS NULL
BEGIN
    UPDATE counters SET value = value + 1 WHERE name = 'sequence';
    UPDATE jobs SET end_sequence = (SELECT value FROM counters WHERE name = 'sequence') WHERE id = NEW.id;
END;

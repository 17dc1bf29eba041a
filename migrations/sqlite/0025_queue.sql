-- Two jobs of one system never run at once, whoever claims them.
DROP INDEX jobs_running;
CREATE UNIQUE INDEX one_running_job_of_a_system ON jobs (system) WHERE state = 'running';

-- The jobs of a state in their order, an index for each. One for all states made the planner go through all jobs of a
-- state to find those of a system, or the first that waits: a claim in a night of ten thousand read all of them.
DROP INDEX jobs_in_state;
CREATE INDEX jobs_queued ON jobs (sequence) WHERE state = 'queued';
CREATE INDEX jobs_succeeded ON jobs (sequence) WHERE state = 'succeeded';
CREATE INDEX jobs_failed ON jobs (sequence) WHERE state = 'failed';
CREATE INDEX jobs_cancelled ON jobs (sequence) WHERE state = 'cancelled';

-- The fits of a system, of which the newest are listed first.
CREATE INDEX fits_of_system ON fits (system);

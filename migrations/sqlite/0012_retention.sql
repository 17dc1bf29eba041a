-- What is looked up when something old is forgotten: who still names a job, a fit or a diagnosis. Without these indexes
-- the keys would read whole tables for every row that goes.
CREATE INDEX batches_of_job ON batch_jobs (job);
CREATE INDEX revisions_of_job ON revisions (job);
CREATE INDEX revisions_of_fit ON revisions (fit);
CREATE INDEX diagnoses_of_fit ON diagnoses (fit);
CREATE INDEX ladders_of_fit ON ladders (fit);
CREATE INDEX jobs_repeated ON jobs (retry_of) WHERE retry_of IS NOT NULL;
CREATE INDEX jobs_of_diagnosis ON jobs (diagnosis) WHERE diagnosis IS NOT NULL;

-- Lists of jobs that stand somehow, or are of a kind, newest first: the few that run among all that ever ended.
CREATE INDEX jobs_in_state ON jobs (state, sequence);
CREATE INDEX jobs_of_kind ON jobs (kind, sequence);

-- Whose a system is, where several share a service. Systems that say nothing belong to one tenant without a name.
ALTER TABLE systems ADD COLUMN tenant TEXT NOT NULL DEFAULT '';
-- As it was when the job was submitted.
ALTER TABLE jobs ADD COLUMN tenant TEXT NOT NULL DEFAULT '';

-- How tenants take turns: start-time fair queueing (Goyal, Vin and Cheng 1996, SIGCOMM), each job counted as one. The
-- tenant whose last job ended first in this count is next. One that comes, or comes back, starts where the others are:
-- it has no claim for the time in which it had nothing to do.
CREATE TABLE tenants (
    tenant  TEXT   PRIMARY KEY,
    started BIGINT NOT NULL,
    ended   BIGINT NOT NULL CHECK (ended >= started)
) WITHOUT ROWID;
INSERT INTO tenants (tenant, started, ended) VALUES ('', 0, 0);
CREATE INDEX tenants_in_turn ON tenants (ended, tenant);

DROP INDEX jobs_waiting;
CREATE INDEX jobs_waiting ON jobs (tenant, priority, turn, sequence) WHERE state = 'queued';

-- The same statements run on PostgreSQL, where `window` is a word of the language.
ALTER TABLE window_blocks RENAME COLUMN window TO window_id;
ALTER TABLE fit_windows RENAME COLUMN window TO window_id;
ALTER TABLE samples RENAME COLUMN window TO window_id;

-- The processes that work, each by a row for one start of it, with a lease by the clock of the database. On a file
-- there is one.
CREATE TABLE workers (
    worker     BIGINT PRIMARY KEY,
    name       TEXT   NOT NULL,
    roles      TEXT   NOT NULL,
    started_at BIGINT NOT NULL,
    until      BIGINT NOT NULL
);
CREATE VIEW clock AS SELECT CAST(unixepoch('subsec') * 1000 AS INTEGER) AS ms;
CREATE INDEX jobs_cancelling ON jobs (boot) WHERE state = 'running' AND cancelling;

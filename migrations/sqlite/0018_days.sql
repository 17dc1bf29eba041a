-- What counts of a system's measurements, by channel and day: the newest window wins, sample by sample. It follows from
-- the windows and is what every reader reads; what one window adds costs what it adds, however many there are.

-- The samples of a channel in one UTC day (days since 1970) and one unit. `owners` says which windows gave them, in
-- order: [[sequence of the window, number of samples], …].
CREATE TABLE days (
    system  TEXT   NOT NULL REFERENCES systems (system),
    channel TEXT   NOT NULL,
    day     BIGINT NOT NULL,
    unit    TEXT   NOT NULL,
    from_s  BIGINT NOT NULL,
    to_s    BIGINT NOT NULL CHECK (to_s >= from_s),
    block   BLOB   NOT NULL,
    owners  TEXT   NOT NULL,
    PRIMARY KEY (system, channel, day, unit)
);
CREATE INDEX days_by_start ON days (system, from_s);
CREATE INDEX days_by_end ON days (system, to_s);

-- Changes whenever the measurements of a system do.
CREATE TABLE measured (
    system  TEXT   PRIMARY KEY REFERENCES systems (system),
    version BIGINT NOT NULL
);

-- A block holds what its window gave: new samples, and others than those that counted when it came. `repeats` says where
-- the window had just what counted then, so that the two are all that it had: [[from, to], …] in seconds. NULL stands
-- for windows of earlier programs, whose blocks are whole; the program takes them into `days` before it does anything
-- else. As before, loosening a CHECK changes the text of the schema alone.
PRAGMA writable_schema = ON;
UPDATE sqlite_schema
SET sql = replace(sql, 'block   BLOB NOT NULL', 'block   BLOB')
WHERE type = 'table' AND name = 'window_blocks';
PRAGMA writable_schema = RESET;
ALTER TABLE window_blocks ADD COLUMN repeats TEXT;
CREATE INDEX blocks_to_take_in ON window_blocks (window) WHERE repeats IS NULL;

-- Uploads that went on with the newest window of the same day are one window with it. Their ids lead there.
ALTER TABLE windows ADD COLUMN uploads BIGINT NOT NULL DEFAULT 1 CHECK (uploads >= 1);
CREATE TABLE window_aliases (
    id       TEXT   PRIMARY KEY CHECK (id LIKE 'win\_%' ESCAPE '\'),
    sequence BIGINT NOT NULL REFERENCES windows (sequence) ON DELETE CASCADE
) WITHOUT ROWID;
CREATE INDEX aliases_of_window ON window_aliases (sequence);

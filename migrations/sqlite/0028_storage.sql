-- Measurements at size: a day of a system, or what a window gave, is one row with all its channels.

-- What was measured by channel, until the program has taken it into the days.
ALTER TABLE days RENAME TO channel_days;
DROP INDEX days_by_start;
DROP INDEX days_by_end;

-- What counts of a system's day (counted from 1970). `channels` is [[channel, unit, owners], …], where owners are
-- [[window, samples], …] by the numbers of windows, or [] where they are those of the channel before; the block holds
-- the samples of all of them.
CREATE TABLE days (
    system   TEXT   NOT NULL REFERENCES systems (system),
    day      BIGINT NOT NULL,
    from_ms  BIGINT NOT NULL,
    to_ms    BIGINT NOT NULL CHECK (to_ms >= from_ms),
    channels TEXT   NOT NULL,
    block    BLOB   NOT NULL,
    PRIMARY KEY (system, day)
);

-- What a window gave when it came, on which day it first did. `channels` is [[channel, unit, repeats], …], where
-- repeats says where the window had just what counted then, [[from, to], …] in milliseconds; a channel without a unit
-- gave no samples.
CREATE TABLE shares (
    window_id TEXT   NOT NULL,
    day       BIGINT NOT NULL,
    channels  TEXT   NOT NULL,
    block     BLOB   NOT NULL,
    PRIMARY KEY (window_id, day)
);

-- What the same search would find again: the way there, and how the estimates err together. Documents of fits are
-- compressed from now on, and so are the reports of windows; earlier ones are read as they are.
ALTER TABLE fits ADD COLUMN replay BLOB;
-- Jobs of a batch that are more than one transaction takes into the queue, until all are there, and how many are.
ALTER TABLE batches ADD COLUMN waiting BLOB;
ALTER TABLE batches ADD COLUMN entered BIGINT NOT NULL DEFAULT 0;
CREATE INDEX batches_to_enter ON batches (sequence) WHERE waiting IS NOT NULL;
CREATE INDEX fits_to_shorten ON fits (created_at) WHERE replay IS NOT NULL;

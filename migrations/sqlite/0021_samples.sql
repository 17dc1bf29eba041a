-- Live samples: rows as they come, each post one row here, until they are laid into the days. A window takes those of
-- one system and UTC day; `day` (since 1970) says which, and is NULL where a window was uploaded as one.
ALTER TABLE windows ADD COLUMN day BIGINT;

-- `rows`: [[channel, unit, hold, [time in milliseconds, …], [value, …]], …].
CREATE TABLE samples (
    sequence BIGINT PRIMARY KEY,
    system   TEXT   NOT NULL REFERENCES systems (system),
    window   TEXT   NOT NULL REFERENCES windows (id) ON DELETE CASCADE,
    from_ms  BIGINT NOT NULL,
    to_ms    BIGINT NOT NULL CHECK (to_ms >= from_ms),
    rows     TEXT   NOT NULL,
    came_at  BIGINT NOT NULL
) WITHOUT ROWID;
CREATE INDEX samples_of_system ON samples (system, sequence);
CREATE INDEX samples_of_window ON samples (window);

-- Which effect a model is missing: jobs of the kind `diagnose`, and what they found.

-- A diagnosis fits its base model on the way, so it has a fit, but it leads to no verdict on what is served: its
-- job has no outcome. Loosening a CHECK does not touch what is stored, so the text of the schema is all that changes
-- (SQLite, "ALTER TABLE", section 7).
PRAGMA writable_schema = ON;
UPDATE sqlite_schema
SET sql = replace(
    replace(sql, 'CHECK (kind IN (''estimate''))', 'CHECK (kind IN (''estimate'', ''diagnose'', ''ladder''))'),
    'CHECK ((state = ''succeeded'') = (outcome IS NOT NULL))',
    'CHECK ((state = ''succeeded'' AND kind = ''estimate'') = (outcome IS NOT NULL))')
WHERE type = 'table' AND name = 'jobs';
PRAGMA writable_schema = RESET;

CREATE TABLE diagnoses (
    id         TEXT   PRIMARY KEY CHECK (id LIKE 'dia\_%' ESCAPE '\'),
    sequence   BIGINT NOT NULL UNIQUE,
    job        TEXT   NOT NULL UNIQUE REFERENCES jobs (id),
    system     TEXT   NOT NULL REFERENCES systems (system),
    fit        TEXT   NOT NULL REFERENCES fits (id),
    verdict    TEXT   NOT NULL CHECK (verdict IN ('named', 'adequate', 'unknown', 'not_enough_data')),
    document   TEXT   NOT NULL,
    created_at BIGINT NOT NULL
);
CREATE INDEX diagnoses_of_system ON diagnoses (system, sequence);

-- Error ladders: the base model, then effects one after another. The newest one of a system is shown.
CREATE TABLE ladders (
    job        TEXT   PRIMARY KEY REFERENCES jobs (id),
    sequence   BIGINT NOT NULL UNIQUE,
    system     TEXT   NOT NULL REFERENCES systems (system),
    fit        TEXT   NOT NULL REFERENCES fits (id),
    document   TEXT   NOT NULL,
    created_at BIGINT NOT NULL
);
CREATE INDEX ladders_of_system ON ladders (system, sequence);

ALTER TABLE jobs ADD COLUMN diagnosis TEXT REFERENCES diagnoses (id);

-- What every window showed of every effect: the long memory of a system. Whatever is forgotten of a diagnosis, its rows
-- stay, so they name it without a key; they go with their system. Windows are added up by base model, whose content may change
-- under its name.
CREATE TABLE evidence (
    diagnosis    TEXT             NOT NULL CHECK (diagnosis LIKE 'dia\_%' ESCAPE '\'),
    effect       TEXT             NOT NULL,
    sequence     BIGINT           NOT NULL,
    system       TEXT             NOT NULL REFERENCES systems (system),
    model        TEXT             NOT NULL,
    model_hash   TEXT,
    -- First sample and end of the last, seconds since 1970.
    from_s       BIGINT           NOT NULL,
    to_s         BIGINT           NOT NULL,
    hours        DOUBLE PRECISION NOT NULL,
    size         DOUBLE PRECISION NOT NULL,
    deviation    DOUBLE PRECISION NOT NULL,
    unit         TEXT             NOT NULL,
    share        DOUBLE PRECISION NOT NULL,
    t            DOUBLE PRECISION NOT NULL,
    beyond_clock DOUBLE PRECISION NOT NULL,
    days         BIGINT           NOT NULL,
    shift_p      DOUBLE PRECISION,
    PRIMARY KEY (diagnosis, effect)
);
CREATE INDEX evidence_of_system ON evidence (system, sequence);

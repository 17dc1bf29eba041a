-- What somebody forecast of a system's inputs, a row per channel: of several issues the newest counts from its first
-- sample to its last, and what older ones say beside that is kept. No reader of measurements looks here.
CREATE TABLE forecast_inputs (
    system    TEXT   NOT NULL REFERENCES systems (system),
    channel   TEXT   NOT NULL,
    issued_at BIGINT NOT NULL, -- of the newest issue, in milliseconds
    version   BIGINT NOT NULL, -- changes whenever the row does
    from_ms   BIGINT NOT NULL,
    to_ms     BIGINT NOT NULL CHECK (to_ms >= from_ms),
    block     BLOB   NOT NULL,
    PRIMARY KEY (system, channel)
);

-- What forecasts said of an output, at most one in a quarter of an hour, to be compared with what came. `at_ms` is the
-- newest measurement that the forecast knew; the blocks hold values and standard deviations at the same instants.
CREATE TABLE said_forecasts (
    system   TEXT   NOT NULL REFERENCES systems (system),
    output   TEXT   NOT NULL,
    quarter  BIGINT NOT NULL, -- quarters of an hour since 1970
    made_at  BIGINT NOT NULL, -- milliseconds
    revision BIGINT NOT NULL,
    at_ms    BIGINT NOT NULL,
    said     BLOB   NOT NULL,
    sd       BLOB   NOT NULL,
    PRIMARY KEY (system, output, quarter)
);
CREATE INDEX said_by_age ON said_forecasts (made_at);

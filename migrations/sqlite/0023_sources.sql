-- Where measurements of other programs belong: one document per source, such as the rules of the line protocol. It says
-- itself who has changed it, and when.
CREATE TABLE sources (
    name       TEXT   PRIMARY KEY,
    document   TEXT   NOT NULL,
    changed_by TEXT   NOT NULL,
    changed_at BIGINT NOT NULL
);

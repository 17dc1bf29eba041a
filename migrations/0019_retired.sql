-- The newest revision of a system that was deleted: one of the same name that comes later goes on from there, so that the
-- revisions under a name never go back.
CREATE TABLE retired (
    system   TEXT   PRIMARY KEY,
    revision BIGINT NOT NULL CHECK (revision > 0)
) WITHOUT ROWID;

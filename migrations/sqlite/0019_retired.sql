-- The newest revision of a system that was deleted: one of the same name that comes later goes on from there, so that the
-- revisions under a name never go back.
CREATE TABLE retired (
    system   TEXT   PRIMARY KEY,
    revision BIGINT NOT NULL CHECK (revision > 0)
) WITHOUT ROWID;

DROP TRIGGER revisions_count_up;
CREATE TRIGGER revisions_count_up BEFORE INSERT ON revisions
WHEN NEW.revision <> 1 + MAX(
    COALESCE((SELECT MAX(revision) FROM revisions WHERE system = NEW.system), 0),
    COALESCE((SELECT revision FROM retired WHERE system = NEW.system), 0))
BEGIN
    SELECT RAISE(ABORT, 'revisions count up by one');
END;

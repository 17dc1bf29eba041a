-- Who may ask. As soon as there is a row, also one that is revoked, nobody is answered without a token: taking the last
-- token away must not open the door.

-- Only a hash of a token is kept (BLAKE3; a token has 256 random bits, so that no salt is needed). `systems` holds
-- patterns, JSON; without it the token is good for every system. What belongs to no system, such as a model, is for
-- administrators, and they are not limited.
CREATE TABLE tokens (
    name       TEXT   PRIMARY KEY CHECK (length(name) BETWEEN 1 AND 64),
    hash       BLOB   NOT NULL UNIQUE CHECK (length(hash) = 32),
    scope      TEXT   NOT NULL CHECK (scope IN ('read', 'operate', 'admin')),
    systems    TEXT   CHECK (systems IS NULL OR scope <> 'admin'),
    created_at BIGINT NOT NULL,
    expires_at BIGINT,
    revoked_at BIGINT
);
-- The name stands in the record of what was done, so it never means another token; and a revoked one stays revoked.
CREATE TRIGGER a_token_does_not_change BEFORE UPDATE ON tokens
WHEN OLD.revoked_at IS NOT NULL OR NEW.name <> OLD.name OR NEW.hash <> OLD.hash OR NEW.scope <> OLD.scope
  OR NEW.systems IS NOT OLD.systems OR NEW.created_at <> OLD.created_at OR NEW.expires_at IS NOT OLD.expires_at
BEGIN
    SELECT RAISE(ABORT, 'a token can be revoked and nothing else');
END;
CREATE TRIGGER a_token_is_not_forgotten BEFORE DELETE ON tokens
BEGIN
    SELECT RAISE(ABORT, 'a token can be revoked and nothing else');
END;

-- What operators did: written in the transaction that did it. `who` is the name of a token, `local` where no token is
-- needed or the database file itself was at hand, `service` for what the service does by itself. The reason stands here,
-- too, because decisions, pins and revisions go with their system, and this does not.
CREATE TABLE audit (
    sequence INTEGER PRIMARY KEY AUTOINCREMENT,
    at       BIGINT  NOT NULL,
    who      TEXT    NOT NULL,
    action   TEXT    NOT NULL CHECK (action IN (
        'promote_fit', 'reject_fit', 'pin', 'unpin', 'put_system', 'delete_system', 'delete_window', 'put_schedule',
        'delete_schedule', 'post_model', 'post_effect', 'create_token', 'revoke_token')),
    system   TEXT,
    subject  TEXT    NOT NULL,
    reason   TEXT
);
CREATE INDEX audit_of_system ON audit (system, sequence);
CREATE TRIGGER what_was_done_does_not_change BEFORE UPDATE ON audit
BEGIN
    SELECT RAISE(ABORT, 'what was done does not change');
END;
CREATE TRIGGER what_was_done_is_not_forgotten BEFORE DELETE ON audit
BEGIN
    SELECT RAISE(ABORT, 'what was done is not forgotten');
END;

-- What lists read of a fit and of a diagnosis, as `../sqlite/0030_listed.sql` tells.
ALTER TABLE fits ADD COLUMN listed TEXT COLLATE "C";
ALTER TABLE fits ADD COLUMN validation_rmse DOUBLE PRECISION;
CREATE INDEX fits_in_trend ON fits (system, model, rowid) INCLUDE (validation_rmse) WHERE validation_rmse IS NOT NULL;
CREATE INDEX fits_to_list ON fits (created_at) WHERE listed IS NULL;

ALTER TABLE diagnoses ADD COLUMN missing TEXT COLLATE "C";
UPDATE diagnoses SET missing = json_build_object(
    'effect', document::JSON #> '{findings,0,effect}',
    'title', document::JSON #> '{findings,0,title}',
    'size', document::JSON #> '{findings,0,size}'
)::TEXT WHERE verdict = 'named';

-- The building of a system, the first level of its group: the systems of one learn from each other.
ALTER TABLE systems ADD COLUMN building TEXT NOT NULL DEFAULT '';
UPDATE systems SET building = substr(json_extract(document, '$.group'), 1, instr(json_extract(document, '$.group') || '/', '/') - 1)
WHERE json_extract(document, '$.group') IS NOT NULL;
CREATE INDEX systems_of_buildings ON systems (building, model) WHERE building <> '';

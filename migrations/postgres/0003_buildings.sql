-- The building of a system, as `../sqlite/0031_buildings.sql` tells.
ALTER TABLE systems ADD COLUMN building TEXT COLLATE "C" NOT NULL DEFAULT '';
UPDATE systems SET building = split_part(document::JSON ->> 'group', '/', 1) WHERE document::JSON ->> 'group' IS NOT NULL;
CREATE INDEX systems_of_buildings ON systems (building, model) WHERE building <> '';

-- Processes go by milliseconds: times of measurements were seconds before. Blocks say in their first bytes what they
-- count in, so they stay as they are.
ALTER TABLE windows RENAME COLUMN from_s TO from_ms;
ALTER TABLE windows RENAME COLUMN to_s TO to_ms;
UPDATE windows SET from_ms = 1000 * from_ms, to_ms = 1000 * to_ms;
ALTER TABLE days RENAME COLUMN from_s TO from_ms;
ALTER TABLE days RENAME COLUMN to_s TO to_ms;
UPDATE days SET from_ms = 1000 * from_ms, to_ms = 1000 * to_ms;
ALTER TABLE evidence RENAME COLUMN from_s TO from_ms;
ALTER TABLE evidence RENAME COLUMN to_s TO to_ms;
UPDATE evidence SET from_ms = 1000 * from_ms, to_ms = 1000 * to_ms;
UPDATE window_blocks SET repeats = (
    SELECT json_group_array(json_array(1000 * json_extract(value, '$[0]'), 1000 * json_extract(value, '$[1]')))
    FROM json_each(repeats)
) WHERE repeats IS NOT NULL;

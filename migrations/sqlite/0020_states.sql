-- States have an object of their own, so that one may be called `at`, `sd` or `revision`.
UPDATE states SET document = json_patch(
    json_object(
        'at', json_extract(document, '$.at'),
        'states', json(json_remove(document, '$.at', '$.free_run', '$.sd')),
        'sd', json(json_extract(document, '$.sd'))),
    CASE WHEN json_extract(document, '$.free_run') THEN '{"free_run":true}' ELSE '{}' END);

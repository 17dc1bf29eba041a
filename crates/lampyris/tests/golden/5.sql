-- A database of schema 5 with a served room, as lampyris 0.2.0 wrote it; 5.json is what /params/room/1 answered.
PRAGMA foreign_keys = OFF;
BEGIN TRANSACTION;
CREATE TABLE _sqlx_migrations (
    version BIGINT PRIMARY KEY,
    description TEXT NOT NULL,
    installed_on TIMESTAMP NOT NULL DEFAULT CURRENT_TIMESTAMP,
    success BOOLEAN NOT NULL,
    checksum BLOB NOT NULL,
    execution_time BIGINT NOT NULL
);
INSERT INTO "_sqlx_migrations" VALUES(1,'initial','2026-11-21 12:39:19',1,X'3DEF3990518AC7080FEED561E0245836146BFD0D0CD9DEC064B8499B6C2464BFA28852D70D022B6A870853304E426A45',1506011);
INSERT INTO "_sqlx_migrations" VALUES(2,'operators','2026-11-21 12:39:19',1,X'E4A95DABBE259002021EE4E9DCE0E45484D6362312FC0AD560F9B3AE3508B6F84258F11CB2F64155A1739AA4196A317F',8149726);
INSERT INTO "_sqlx_migrations" VALUES(3,'fit windows','2026-11-21 12:39:19',1,X'1A3463295EA69B0A0ECFF657460DAC9DD565CA14F6FBD3C51B65C077F62018C7A15C7BEEBE03BE9ACD34066222B32D28',3887503);
INSERT INTO "_sqlx_migrations" VALUES(4,'job history','2026-11-21 12:39:19',1,X'72CDAE8CC68F1D233308F61AAC98F431DB54757A0F2F6C7640A8F41DB2D6E5161DAE0CCE38A658C7FDFC909721B72798',964381);
INSERT INTO "_sqlx_migrations" VALUES(5,'diagnoses','2026-11-21 12:39:19',1,X'8048BF835117848B295CAD391E7C845A27385315BEAE2D8E5443217D57B037F1C80189D77A163CBF5EE387D32C371E42',1091901);
CREATE TABLE batch_jobs (
    batch TEXT NOT NULL REFERENCES batches (id),
    job   TEXT NOT NULL REFERENCES jobs (id),
    PRIMARY KEY (batch, job)
);
CREATE TABLE batches (
    id         TEXT   PRIMARY KEY CHECK (id LIKE 'bat\_%' ESCAPE '\'),
    sequence   BIGINT NOT NULL UNIQUE,
    kind       TEXT   NOT NULL CHECK (kind IN ('recalibrate')),
    schedule   TEXT,
    request    TEXT   NOT NULL,
    skipped    TEXT   NOT NULL,
    created_at BIGINT NOT NULL
);
CREATE TABLE counters (
    name  TEXT   PRIMARY KEY CHECK (name IN ('boot', 'sequence')),
    value BIGINT NOT NULL CHECK (value >= 0)
);
INSERT INTO "counters" VALUES('boot',1);
INSERT INTO "counters" VALUES('sequence',4);
CREATE TABLE decisions (
    fit        TEXT   PRIMARY KEY REFERENCES offers (fit),
    decision   TEXT   NOT NULL CHECK (decision IN ('promoted', 'rejected')),
    reason     TEXT   NOT NULL,
    decided_at BIGINT NOT NULL
);
CREATE TABLE degradations (
    system      TEXT   PRIMARY KEY REFERENCES systems (system),
    revision    BIGINT NOT NULL,
    description TEXT   NOT NULL,
    since_at    BIGINT NOT NULL,
    FOREIGN KEY (system, revision) REFERENCES revisions (system, revision)
);
CREATE TABLE diagnoses (
    id         TEXT   PRIMARY KEY CHECK (id LIKE 'dia\_%' ESCAPE '\'),
    sequence   BIGINT NOT NULL UNIQUE,
    job        TEXT   NOT NULL UNIQUE REFERENCES jobs (id),
    system     TEXT   NOT NULL REFERENCES systems (system),
    fit        TEXT   NOT NULL REFERENCES fits (id),
    verdict    TEXT   NOT NULL CHECK (verdict IN ('named', 'adequate', 'unknown', 'not_enough_data')),
    document   TEXT   NOT NULL,
    created_at BIGINT NOT NULL
);
CREATE TABLE effects (
    id         TEXT   PRIMARY KEY,
    document   TEXT   NOT NULL,
    created_at BIGINT NOT NULL
);
CREATE TABLE fallbacks (
    system        TEXT   PRIMARY KEY REFERENCES systems (system),
    reason        TEXT   NOT NULL CHECK (reason IN ('validation_failed', 'job_failed')),
    job           TEXT   NOT NULL REFERENCES jobs (id),
    fit           TEXT   REFERENCES fits (id),
    failed_checks TEXT   NOT NULL,
    since_at      BIGINT NOT NULL,
    CHECK ((reason = 'validation_failed') = (fit IS NOT NULL))
);
CREATE TABLE fit_windows (
    fit    TEXT NOT NULL REFERENCES fits (id) ON DELETE CASCADE,
    window TEXT NOT NULL REFERENCES windows (id),
    PRIMARY KEY (fit, window)
) WITHOUT ROWID;
INSERT INTO "fit_windows" VALUES('fit_014c3921c819232b43ca','win_df8aae42133aa8464c6e');
CREATE TABLE fits (
    id         TEXT   PRIMARY KEY CHECK (id LIKE 'fit\_%' ESCAPE '\'),
    job        TEXT   NOT NULL UNIQUE REFERENCES jobs (id),
    system     TEXT   NOT NULL REFERENCES systems (system),
    model      TEXT   NOT NULL,
    document   TEXT   NOT NULL,
    verdict    TEXT   NOT NULL CHECK (verdict IN ('accepted', 'unchanged', 'held', 'rejected')),
    checks     TEXT   NOT NULL,
    summary    TEXT   NOT NULL,
    created_at BIGINT NOT NULL
);
INSERT INTO "fits" VALUES('fit_014c3921c819232b43ca','job_3dc519a2ab61d58d1372','room/1','rc2','{"model":"rc2","model_hash":"7e148c0693be9b7b49989e81339a7a4369141dcba3f9edf1874dcc6bd7d3aa91","dropped":[],"parameters":{"alpha_e":{"value":0.11755388438382988,"unit":"1/h","ci95":null,"bounds":[0.001,15.0],"at_bound":false,"fixed":false},"beta_e":{"value":49.99999999999999,"unit":"-","ci95":null,"bounds":[0.05,50.0],"at_bound":true,"fixed":false},"alpha_a":{"value":0.6604934418325709,"unit":"1/h","ci95":null,"bounds":[0.001,15.0],"at_bound":false,"fixed":false},"T_e0":{"value":10.0,"unit":"degC","ci95":null,"bounds":[10.0,40.0],"at_bound":true,"fixed":false}},"correlated":[{"parameters":["alpha_e","beta_e"],"correlation":-0.9999999989405108},{"parameters":["alpha_e","alpha_a"],"correlation":-0.999999994618394},{"parameters":["beta_e","alpha_a"],"correlation":0.9999999914952373},{"parameters":["alpha_e","T_e0"],"correlation":-0.999999768224602},{"parameters":["beta_e","T_e0"],"correlation":0.9999997635414486},{"parameters":["alpha_a","T_e0"],"correlation":0.9999997571056229}],"method":"lm_multistart","objective":"mse","cost":0.017675760098169877,"stopped_by":"budget","seed":1,"evaluations":626,"trace":[{"evaluations":20,"best":0.3088094349707649},{"evaluations":35,"best":0.09365299005923697},{"evaluations":51,"best":0.09364756257593554},{"evaluations":67,"best":0.033421230006451565},{"evaluations":83,"best":0.03341735555659422},{"evaluations":99,"best":0.020157094584985057},{"evaluations":115,"best":0.020156816911480944},{"evaluations":131,"best":0.019467210967386052},{"evaluations":147,"best":0.019466760973638548},{"evaluations":163,"best":0.018461452882588814},{"evaluations":179,"best":0.017754015928881376},{"evaluations":195,"best":0.017753670665973637},{"evaluations":211,"best":0.017675782521331704},{"evaluations":227,"best":0.017675776944191965},{"evaluations":243,"best":0.017675760101424628},{"evaluations":271,"best":0.017675760098169877}],"metrics":{"T_room":{"unit":"K","train_rmse":0.1329502166157313,"validation_rmse":0.07470825505651102,"test_rmse":null,"ahead":{"PT1H":{"rmse":0.04747188217409985,"persistence":0.5334910271563507,"n":71},"PT6H":{"rmse":0.08644002814300791,"persistence":2.9373650839423475,"n":66},"PT24H":{"rmse":0.07431393603747938,"persistence":3.704107517338015,"n":48}},"day_ahead_mse":0.0055541605073829445,"noise_floor":0.05616193548863356,"rho":3.541215411420478}},"sample_s":3600,"substeps":6,"discretisation_error":0.00018025750771943905,"process_noise":0.030778326795495962,"parts":{"train":{"from":"2026-01-02T00:00:00Z","to":"2026-01-07T23:00:00Z"},"validation":{"from":"2026-01-08T00:00:00Z","to":"2026-01-10T23:00:00Z"},"test":null},"input_hash":"a0cfbf62bcaf5500ec0061dd00770df00d6ff2a10fb268dd9b96c27881e67332","basis":{"from":"2026-01-01T00:00:00Z","to":"2026-01-10T23:00:00Z","channels":["T_out","T_room","hour_of_day","weekday","window_drop"],"sets":{},"location":null,"zone":null,"lead":0},"worst_regime":"night (22 to 6 h): T_room is 0.11 K lower than the model says, 33 % of the time, 64 % of the squared error.","remarks":["beta_e, T_e0 sits on a bound of the search: the value is a limit, not an estimate","alpha_e and beta_e move together (correlation -1.00): trust their effect, not their separate values","alpha_e and alpha_a move together (correlation -1.00): trust their effect, not their separate values","beta_e and alpha_a move together (correlation 1.00): trust their effect, not their separate values","alpha_e and T_e0 move together (correlation -1.00): trust their effect, not their separate values","beta_e and T_e0 move together (correlation 1.00): trust their effect, not their separate values","alpha_a and T_e0 move together (correlation 1.00): trust their effect, not their separate values","the search ended before two of its restarts agreed"],"non_identifiable":[]}','accepted','[{"name":"G1 finite","statistic":0.0,"operator":"<=","threshold":1e-9,"unit":"-","pass":true,"severity":"reject","comment":"every number is finite, and the stored parameters reproduce the stored error"},{"name":"G2 bounds","statistic":0.0,"operator":"<=","threshold":0.0,"unit":"parameters","pass":true,"severity":"reject","comment":"every estimate lies inside its bounds"},{"name":"G2 at bound","statistic":null,"operator":"","threshold":null,"unit":"-","pass":false,"severity":"flag","comment":"beta_e sits on a bound of the search: its value is a limit, not an estimate"},{"name":"G2 at bound","statistic":null,"operator":"","threshold":null,"unit":"-","pass":false,"severity":"flag","comment":"T_e0 sits on a bound of the search: its value is a limit, not an estimate"},{"name":"G3 stable","statistic":-0.11704750873644838,"operator":"<","threshold":0.0,"unit":"1/h","pass":true,"severity":"reject","comment":"left alone, every temperature settles"},{"name":"G3 time constants","statistic":8.543539378114092,"operator":"<=","threshold":1440.0,"unit":"h","pass":true,"severity":"reject","comment":"time constants from 1.507 h to 8.5 h; physics allows 0.0014 h to 1440 h"},{"name":"G3 gain of T_out","statistic":1.0000000000000004,"operator":">","threshold":0.0,"unit":"-","pass":true,"severity":"reject","comment":"one unit more of T_out moves T_r by 1.000 in the end; it must be above 0 and at most 1.05"},{"name":"G3 state range","statistic":0.0,"operator":"<=","threshold":0.0,"unit":"K","pass":true,"severity":"reject","comment":"all states stay within [-30, 60], on these data and in a fortnight of harsh weather"},{"name":"G4 beats persistence","statistic":0.02942774414237726,"operator":"<=","threshold":1.0,"unit":"-","pass":true,"severity":"reject","comment":"forecasts PT6H ahead err by 0.09, holding the last measurement by 2.94"},{"name":"G5 largest error","statistic":0.5535087975061996,"operator":"<=","threshold":10.0,"unit":"K","pass":true,"severity":"reject","comment":"the free run never errs by more than 10 K"},{"name":"G5 excursion","statistic":0.0,"operator":"<=","threshold":5.0,"unit":"K","pass":true,"severity":"reject","comment":"how far the free run leaves the range that was ever measured"},{"name":"G7 repeat","statistic":null,"operator":"","threshold":null,"unit":"-","pass":false,"severity":"flag","comment":"the search ended before two restarts agreed"},{"name":"G8 unseen data","statistic":72.0,"operator":">","threshold":0.0,"unit":"samples","pass":true,"severity":"reject","comment":"there are measurements that the search has not seen"},{"name":"G8 complete","statistic":1.0,"operator":">=","threshold":0.9,"unit":"-","pass":true,"severity":"reject","comment":"share of samples at which the output and all inputs are known"},{"name":"G8 no unit jump","statistic":0.9499999999999993,"operator":"<=","threshold":15.0,"unit":"K","pass":true,"severity":"reject","comment":"largest change of the output from one sample to the next; a change of unit would be larger"},{"name":"G8 not stuck","statistic":0.0,"operator":"<=","threshold":24.0,"unit":"h","pass":true,"severity":"reject","comment":"longest time for which the output sensor showed one value"}]','accepted with flags at_bound:beta_e, at_bound:T_e0, low_confidence',1795264761254);
CREATE TABLE idempotency (
    key         TEXT   PRIMARY KEY,
    fingerprint TEXT   NOT NULL,
    resource    TEXT   NOT NULL,
    status      BIGINT NOT NULL,
    created_at  BIGINT NOT NULL
);
CREATE TABLE jobs (
    id          TEXT    PRIMARY KEY CHECK (id LIKE 'job\_%' ESCAPE '\'),
    sequence    BIGINT  NOT NULL UNIQUE,
    kind        TEXT    NOT NULL CHECK (kind IN ('estimate', 'diagnose', 'ladder')),
    system      TEXT    NOT NULL REFERENCES systems (system),
    model       TEXT    NOT NULL,
    request     TEXT    NOT NULL,
    fingerprint TEXT    NOT NULL,
    experiment  BOOLEAN NOT NULL,
    origin      TEXT    NOT NULL CHECK (origin IN ('posted', 'scheduled')),
    priority    BIGINT  NOT NULL CHECK (priority IN (0, 1, 2)),
    turn        BIGINT  NOT NULL CHECK (turn >= 0),
    state       TEXT    NOT NULL CHECK (state IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    outcome     TEXT    CHECK (outcome IN ('accepted', 'held', 'rejected', 'suggested', 'unchanged')),
    boot        BIGINT,
    attempt     BIGINT  NOT NULL DEFAULT 0 CHECK (attempt BETWEEN 0 AND 3),
    requeued    BOOLEAN NOT NULL DEFAULT FALSE,
    cancelling  BOOLEAN NOT NULL DEFAULT FALSE,
    fit         TEXT,
    revision    BIGINT,
    error       TEXT,
    stopped_by  TEXT    CHECK (stopped_by IN ('converged', 'stalled', 'budget', 'deadline', 'cancelled', 'target')),
    evaluations BIGINT,
    created_at  BIGINT  NOT NULL,
    started_at  BIGINT,
    ended_at    BIGINT, retry_of TEXT REFERENCES jobs (id), end_sequence BIGINT, diagnosis TEXT REFERENCES diagnoses (id),
    -- What a state implies is in the row, and nothing else is.
    CHECK ((state = 'running') = (boot IS NOT NULL)),
    CHECK ((state = 'succeeded' AND kind = 'estimate') = (outcome IS NOT NULL)),
    CHECK ((state = 'succeeded') = (fit IS NOT NULL)),
    CHECK ((state = 'failed') = (error IS NOT NULL)),
    CHECK ((state IN ('succeeded', 'failed', 'cancelled')) = (ended_at IS NOT NULL))
);
INSERT INTO "jobs" VALUES('job_3dc519a2ab61d58d1372',2,'estimate','room/1','rc2','{"model":"rc2","window":null,"split":{"train":"P6D","validation":"P3D"},"objective":"mse","prior":"none","method":{"seed":1,"name":"lm_multistart","starts":200,"lockstep":4,"converge":true,"local":{"iterations":200,"step":1e-6,"tolerance":0.0001,"damping":0.01,"trials":4,"spread":2.0,"merge":0.001,"radius":0.05,"radius_end":1e-9,"evaluations":20000},"agreement":{"within":0.005,"improvement":0.001,"confirmations":1,"patience":8}},"early_stopping":null,"budget":{"evaluations":600,"wall":null},"bounds":{},"fixed":{},"start_from":"current"}','3c85d5e114bf5594820fc95f915c9602fad318ae3fc0370c4df41419727dbf3f',0,'posted',1,0,'succeeded','accepted',NULL,1,0,0,'fit_014c3921c819232b43ca',1,NULL,'budget',626,1795264761209,1795264761209,1795264761254,NULL,4,NULL);
CREATE TABLE ladders (
    job        TEXT   PRIMARY KEY REFERENCES jobs (id),
    sequence   BIGINT NOT NULL UNIQUE,
    system     TEXT   NOT NULL REFERENCES systems (system),
    fit        TEXT   NOT NULL REFERENCES fits (id),
    document   TEXT   NOT NULL,
    created_at BIGINT NOT NULL
);
CREATE TABLE model_versions (
    id         TEXT   PRIMARY KEY,
    parent     TEXT   NOT NULL,
    effect     TEXT   NOT NULL,
    document   TEXT   NOT NULL,
    created_at BIGINT NOT NULL
);
CREATE TABLE models (
    id         TEXT   PRIMARY KEY,
    document   TEXT   NOT NULL,
    created_at BIGINT NOT NULL
);
CREATE TABLE offers (
    fit    TEXT PRIMARY KEY REFERENCES fits (id),
    served TEXT NOT NULL,
    state  TEXT
);
CREATE TABLE pins (
    system    TEXT   PRIMARY KEY REFERENCES systems (system),
    revision  BIGINT NOT NULL,
    reason    TEXT   NOT NULL,
    since_at  BIGINT NOT NULL,
    FOREIGN KEY (system, revision) REFERENCES revisions (system, revision)
);
CREATE TABLE revisions (
    system       TEXT    NOT NULL REFERENCES systems (system),
    revision     BIGINT  NOT NULL CHECK (revision >= 1),
    fit          TEXT    NOT NULL REFERENCES fits (id),
    job          TEXT    NOT NULL REFERENCES jobs (id),
    served       TEXT    NOT NULL,
    served_hash  TEXT    NOT NULL,
    model_hash   TEXT    NOT NULL,
    window_from  TEXT    NOT NULL,
    window_to    TEXT    NOT NULL,
    current      BOOLEAN NOT NULL,
    fitted_at    BIGINT  NOT NULL,
    validated_at BIGINT  NOT NULL, cause TEXT NOT NULL DEFAULT 'accepted' CHECK (cause IN ('accepted', 'promoted', 'pinned')), reason TEXT, published_at BIGINT,
    PRIMARY KEY (system, revision)
);
INSERT INTO "revisions" VALUES('room/1',1,'fit_014c3921c819232b43ca','job_3dc519a2ab61d58d1372','{"model":"rc2","parameters":{"alpha_e":0.11755388438382988,"beta_e":49.99999999999999,"alpha_a":0.6604934418325709,"T_e0":10.0},"units":{"alpha_e":"1/h","beta_e":"-","alpha_a":"1/h","T_e0":"degC"},"ci95":{"alpha_e":null,"beta_e":null,"alpha_a":null,"T_e0":null},"flags":["at_bound:beta_e","at_bound:T_e0","low_confidence"],"error":{"T_room":{"unit":"K","train_rmse":0.1329502166157313,"validation_rmse":0.07470825505651102,"ahead":{"PT1H":0.04747188217409985,"PT6H":0.08644002814300791,"PT24H":0.07431393603747938}}}}','344e3b10ca605bce8924048a61d44db1f88d0b416c8045d428712f6d1fa1c0cb','7e148c0693be9b7b49989e81339a7a4369141dcba3f9edf1874dcc6bd7d3aa91','2026-01-02T00:00:00Z','2026-01-10T23:00:00Z',1,1795264761254,1795264761254,'accepted',NULL,1795264761254);
CREATE TABLE schedules (
    name         TEXT    PRIMARY KEY,
    cron         TEXT    NOT NULL,
    zone         TEXT    NOT NULL,
    request      TEXT    NOT NULL,
    enabled      BOOLEAN NOT NULL,
    last_tick_at BIGINT  NOT NULL,
    last_run_at  BIGINT,
    last_batch   TEXT    REFERENCES batches (id),
    last_result  TEXT    CHECK (last_result IN ('submitted', 'skipped_overlap', 'nothing_to_do')),
    updated_at   BIGINT  NOT NULL
);
INSERT INTO "schedules" VALUES('nightly','30 2 * * *','UTC','{"systems":["room/*"]}',0,1795264759106,NULL,NULL,NULL,1795264759106);
CREATE TABLE states (
    system   TEXT   PRIMARY KEY REFERENCES systems (system),
    revision BIGINT NOT NULL,
    document TEXT   NOT NULL,
    FOREIGN KEY (system, revision) REFERENCES revisions (system, revision)
);
INSERT INTO "states" VALUES('room/1',1,'{"at":"2026-01-10T23:00:00Z","T_r":9.51753423733371,"T_e":8.045134243154257,"sd":{"T_r":0.031512115491294866,"T_e":0.02669343293028649}}');
CREATE TABLE systems (
    system     TEXT   PRIMARY KEY CHECK (system LIKE '_%/_%'),
    model      TEXT   NOT NULL,
    document   TEXT   NOT NULL,
    created_at BIGINT NOT NULL,
    updated_at BIGINT NOT NULL
);
INSERT INTO "systems" VALUES('room/1','rc2','{"label":"Golden","location":null,"model":"rc2","channels":{},"neighbours":[],"policy":{"mode":"auto","stale_after":"P36500D","horizon":"PT6H","refit_when_degraded":true},"prior":"none","exclude":[]}',1795264761204,1795264761204);
CREATE TABLE window_blocks (
    window  TEXT NOT NULL REFERENCES windows (id) ON DELETE CASCADE,
    channel TEXT NOT NULL,
    block   BLOB NOT NULL,
    PRIMARY KEY (window, channel)
);
INSERT INTO "window_blocks" VALUES('win_df8aae42133aa8464c6e','T_room',X'4C5953315CC7FDE4D31A2857D422AB40215C554F804E6E93B63442CB952E759809D1BD01789CED54416C1AE915FE81C4562735D14A868361C71A53E1B8B15369DB308185740522B6AB0C0813BB20D25676A78A569A028B7064C8217B9970402C8CA6EA6ECAC21E4C17998428B092A1165C6CE18C0FDD4A86C5466B882C8F56C293434C33D17615653A265BA9F79E5AF53DFDEFFDEF7DFF7BDFFF4BBFDE00B8F19B80CFF7FB3300FFDD2D0B780E44F9CBFCFBA72EA1FEBFFEEF2A59368D32AEF82860DAED367174ED4E14AC29CC335037E4D53F89EF2108469263C547B7FEFCB32F762B66F971ECE9D35B773AF395171FBCBA4CED51262A3B5A2E2ABAAE9E7C6444BE8D91132F5C9F3D41B75E90898FE0F61EA4AF5CBF8E0017F1A7674F27B197CFD60EAE7377802E54C8DE401E5C8A0E632413A5D8D8571FCC5DBBE672CDC52F6E06E08C9D7BF428433F7FFFD9A5CE8DDB5FCCC546402A72F90E281F72FA94F9DD82A1A7B4D940B64BDCBEADA857AD1F47CBCF6E887CAF62AF5B9FFDE4DD91F59911607FFBE3DFBE28CBD7F1D1B997DF8EFF747951FE12D97B955A3765FFCE1D42A476719304DA60305888C1DC14C879E4E31399A3F2816673351A35A8D5919D2C497736674FE4FAB5491C27B995F993E696D0C69CD69E3949C23B73791F83BADDA8D2A07AD85C346B0EA0A6C2868682AB7BEC098A92C057B8EF585A373154D28F668E408BDD4CDA53B9C8F08241AD9DB42426315359A9F4F9CA9B4525134A98F2D96C02DBAE5091153B539B318600A16873000EE7D9A0B257EB326E9D0E24F30586F1603C6499821D76914F300A7838D3F3ED8FFB802160A59B87FA7D8A2C334292E74894493A85E03E9F6C38EEED714992E740B25EAFD7D0507E1DE4087D2A43C70EFD71DE3F39D90D04D4DAB4C2B6028D6FEBD96C91A615F9A3F96DCF9010D4D9950CE4E548ED4CA9AA39C0F1034FD7FBD8434271FF45CF82A1C3D6FDAB89ED767B18546BF7CBD17D5E33EDDD6AD331805390D714CCA9E75CDD40B228B714510876BBAB5598673C086BE64BE9B459A73A99561F991025D2634171219807E47029B1EB6694190DDE6A016FA9862004DA9C90AF8B5F54E4137A027D9C602A4BA90AE8324ACC738F5DB272B046201A79C58186B00BBB4B0DAFB3AC5A75108A0B0E406018A6ECB0A57D902BB0C1840DBDB765BC602A16330C134886170C4717532A369166306CA1149B57F950A1DE32B935131B0E2E8974F8B89FA2FC44A6BCE9534C18B71EFA5CDD150A33F92DAA60700EF0CAFBF0D452230E6F0C056D28A0A72F6EF0BBB9C0CC62862118BD9C69EF9138CEF3E485312242418D4E380CB57CDB7020C6473C2443811D57BD04B8471DCB2CAEF1D0710AC7C14647198914DA9E8C7E9F8379914F60046CCDAC3989064F400671EB7CAA4454E920E342D1595AF0C78B266136EADCB0C35E7FB9B870B30C8A288A7A56A8CE12C8D512BB66434735D4BB09310C8D200C71ECEAC61E067D094B784CA77375D0795FF540C0701E8F67BA650741869BC62DAB75AB401F42D5854C6FE871753173348D4226B9AF5E9F014DCF7D723DEA3486BA68DDD00118FCB0DB98CD31084923C531563F165CE528AAD9E46E460BEAE90967F8F87802AFA8420CDA5013C39A69A05DC43AC0311D968F5371C266B4D234E8863D6A754DBC12BBE4201B229FA011745928BE3DB5BB0DE808DEAA7A2D53EE32671476EC1DD796718717C6A7EC5DD3D92BD5F4ACEB3C0C66DBED5F11474FBE8B7EF863A56516EAAE7851E6FC2FC7C66C9108F2CEDA61A6F478B762F9E838DA721F867FFD5565F9B980D28DB72A89CFD3578A7FE0BEEE0D29FF18B37E39F060F993C40C2ABD6CA563E9D4DE2FFEF10AFBEBE28749A2F5E093FCDFDEF9D1379FC6D6BE7DEF65E8F137CE6C0E39ABF832327B2EC19EABFB1D35EBD71E477CB2D69F576B6B19FAC4C7221D67A0301787419244C36FE695D5783AAF300C7CCE118180B25E3527A265CEB9C99377E3422B3D614CEA7654C0F6E95BECF215B98E4D3B7A77B5A6EF16633D6D4348AD57B5CB97A4033209F85ECE4B640312E9D57E4ADC4AAF4A6492C13E2A0183E212D33F17F5F4944C2E3A119001C9791111ED698164544CBE692701DFEF44237B53FEAF3E62387A0A83FE02A71C52B974507AF58C4C2E66647289189C0203A769F520F4FA07676567A0D7E706DE1E1C92F5EF2B910D4A87443E18484665033F3C63924AC4923E00C47632F0C6C9FB0FE84703FDB692F7C07F81DCFD37FB1FCA3F01B93778DD');
INSERT INTO "window_blocks" VALUES('win_df8aae42133aa8464c6e','T_out',X'4C595331CDF43E336D862A4473D887882A0C0C73E09489597FC4CEBC80734FCCFECC088F789CED8F3F6FD43018C61FDBC9B92D7749253AB4A2BDEBDCD55229E8502BB13074C48AD485058C9858604E3E02ABF30DE28C9D98F802C978DF8085ED1684844CCCEB9E8AA02C5D105275AFA5C47EFF3CEFF34BF1FCC5DBF7EF12BC7CF5FA2996A0F8A8DFC4DF87FDF5B9BB070AD0805143E10DEAA2A88DAF8D81D1438B1645AD94D1BA2DBCAFFBB62D9AA6197AD4B56A8A562B83B6AFBDE907EDBD56A056D04C0F45038D8A5FDF024581D6D7502408BF12E807349EAAA6A7795F0C431F33B1B5213364A8A9692B55A993F69334EDF3CD30A8BE27A7A041B282DAB4ADA707D5EB22AE464BFE353119A3544F4A455D93221D431912F6BF78830E06566B6B82BDE20D0E0EDA5EF13A1D82ED9CD3CEB9D0C15A45D7C8EB3A1B4C47B3E19AD7A1235E2AABF82511680D172C54BC87954017284555D3D17C9CEE6226B6BA15AFB391B78B9D2B5E120C2E04D575E414344856600DA9D183EA56C7D570E4FF9AB78B4AD6BADF79C39A77CDBBE6DDBB748BA33F784BAD2A6AADAAA3EABCBA5C5CF396AEAAB4AE5C6971198E50FD33DEBDC55FBCE7A4B4B8C9BB3339911998009F487EFC6092FEF89E33BEBB759AB2B1846410991809CC9990639EE55BA74996F21918C354483E1981438CC689987129589E3330CE30E20723BA8DF88C33C9784E4D9C54253B10524C44862CE7D48429A6C998274F36D3DDF1B7EDADC3C32FF7371E0BC153923EC9E536B05C8A7BBBB3B0943B9B279206592E249B6F1CF0CFFAE2E2D957BE933CDC14C96CCA66D81F892C9D4B3116D923262792CD888A5C88693249C53C8348F87172861B5196F82F51A2AA7073F7D9A7AB4C196ED77E8BF8094BE04E26');
CREATE TABLE windows (
    id          TEXT   PRIMARY KEY CHECK (id LIKE 'win\_%' ESCAPE '\'),
    system      TEXT   NOT NULL REFERENCES systems (system),
    sequence    BIGINT NOT NULL UNIQUE,
    from_s      BIGINT NOT NULL,
    to_s        BIGINT NOT NULL CHECK (to_s >= from_s),
    report      TEXT   NOT NULL,
    uploaded_at BIGINT NOT NULL
);
INSERT INTO "windows" VALUES('win_df8aae42133aa8464c6e','room/1',1,1767225600,1768086000,'{"rows":240,"from":"2026-01-01T00:00:00Z","to":"2026-01-10T23:00:00Z","channels":{"T_room":{"unit":"degC","hold":"linear","samples":240,"missing":0,"min":1.11,"max":21.64,"median_step_s":3600,"longest_gap_s":3600,"stuck_s":3600,"quantum":0.01},"T_out":{"unit":"degC","hold":"linear","samples":240,"missing":0,"min":-4.1,"max":26.4,"median_step_s":3600,"longest_gap_s":3600,"stuck_s":3600,"quantum":0.1}},"rejected_rows":[],"warnings":[]}',1795264761206);
CREATE INDEX windows_of_system ON windows (system, sequence);
CREATE UNIQUE INDEX one_waiting_equal_job ON jobs (fingerprint) WHERE state = 'queued' AND NOT requeued;
CREATE INDEX jobs_waiting ON jobs (priority, turn, sequence) WHERE state = 'queued';
CREATE INDEX jobs_turns ON jobs (system, priority, turn) WHERE state = 'queued';
CREATE INDEX jobs_running ON jobs (system) WHERE state = 'running';
CREATE INDEX jobs_of_system ON jobs (system, sequence);
CREATE TRIGGER a_verdict_is_final BEFORE UPDATE OF verdict, document ON fits
BEGIN
    SELECT RAISE(ABORT, 'a fit and its verdict do not change');
END;
CREATE UNIQUE INDEX one_current_revision ON revisions (system) WHERE current;
CREATE TRIGGER revisions_count_up BEFORE INSERT ON revisions
WHEN NEW.revision <> 1 + COALESCE((SELECT MAX(revision) FROM revisions WHERE system = NEW.system), 0)
BEGIN
    SELECT RAISE(ABORT, 'revisions count up by one');
END;
CREATE TRIGGER a_revision_does_not_change BEFORE UPDATE OF system, revision, fit, served, served_hash ON revisions
BEGIN
    SELECT RAISE(ABORT, 'a revision does not change');
END;
CREATE INDEX idempotency_by_age ON idempotency (created_at);
CREATE TRIGGER an_offer_needs_a_fit_that_passed BEFORE INSERT ON offers
WHEN NOT EXISTS (SELECT 1 FROM fits WHERE id = NEW.fit AND verdict IN ('accepted', 'held'))
BEGIN
    SELECT RAISE(ABORT, 'only a fit that was accepted or held can be offered');
END;
CREATE TRIGGER a_decision_is_final BEFORE UPDATE ON decisions
BEGIN
    SELECT RAISE(ABORT, 'a decision does not change');
END;
CREATE TRIGGER a_revision_needs_an_accepted_fit BEFORE INSERT ON revisions
WHEN NOT EXISTS (
    SELECT 1 FROM fits f LEFT JOIN decisions d ON d.fit = f.id
    WHERE f.id = NEW.fit AND f.system = NEW.system AND (f.verdict = 'accepted' OR (f.verdict = 'held' AND d.decision = 'promoted')))
BEGIN
    SELECT RAISE(ABORT, 'a revision needs an accepted fit of its system, or a held one that an operator has promoted');
END;
CREATE INDEX fits_of_window ON fit_windows (window);
CREATE INDEX jobs_ended ON jobs (end_sequence);
CREATE TRIGGER an_end_is_numbered AFTER UPDATE OF state ON jobs
WHEN NEW.ended_at IS NOT NULL AND OLD.ended_at IS NULL
BEGIN
    UPDATE counters SET value = value + 1 WHERE name = 'sequence';
    UPDATE jobs SET end_sequence = (SELECT value FROM counters WHERE name = 'sequence') WHERE id = NEW.id;
END;
CREATE INDEX diagnoses_of_system ON diagnoses (system, sequence);
CREATE INDEX ladders_of_system ON ladders (system, sequence);
COMMIT;

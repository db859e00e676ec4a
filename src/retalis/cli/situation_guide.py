"""Situations on robots with what solves them, for command ``help`` and ``docs/reference/situations.md``."""

from typing import Dict, NamedTuple, Sequence


class Situation(NamedTuple):
    """A situation in the words of a user, and what solves it.

    Attributes:
        need: continues "I want to ...".
        solution: operator, predicate or command.
        example: one line: a rule, a directive (``:- ``), a goal (``?- ``) or a command (``$ ``).
        page: page that explains it, relative to ``docs/``.
        keywords: further words by which users search for it.
    """

    need: str
    solution: str
    example: str
    page: str
    keywords: str


_LANGUAGE = "reference/language"
"""Folder of the pages of the event language, relative to ``docs/``."""

SITUATIONS: Dict[str, Sequence[Situation]] = {
    "Something does not happen": (
        Situation(
            "know that a message is missing for N seconds",
            "P seq absent(Q, N)",
            "lost(R) <- heartbeat(R) seq absent(heartbeat(R), 2).",
            "how-to/missing-message.md",
            "heartbeat silent silence watchdog lost dead alive sensor topic stopped timeout late",
        ),
        Situation(
            "know that a request has no reply in time",
            "P seq absent(Q, N)",
            "unanswered(Id) <- request(Id) seq absent(reply(Id), 5).",
            f"{_LANGUAGE}/absent.md",
            "answer response service timeout missing unanswered deadline",
        ),
        Situation(
            "cancel a task or action that takes too long",
            "P seq absent(Q, N)",
            "cancel(G) <- started(G) seq absent(ended(G), 20).",
            "how-to/task-timeout.md",
            "timeout goal actionlib overdue abort deadline",
        ),
        Situation(
            "know that a door is open for too long",
            "P seq absent(Q, N)",
            "left_open(D) <- opened(D) seq absent(closed(D), 60).",
            "how-to/task-timeout.md",
            "state lasts longer duration stays remains timeout window gate",
        ),
        Situation(
            "warn about a low battery, at most once a minute",
            "P with throttle(N, Key)",
            "low(B) <- (battery(B, V) where V < 11.5) with throttle(60, B).",
            "how-to/limit-alerts.md",
            "voltage charge threshold below empty level percentage warning",
        ),
        Situation(
            "match A then B, with no C between them",
            "(P seq Q) cnot R",
            "confirmed <- (asked seq yes) cnot no.",
            f"{_LANGUAGE}/cnot.md",
            "not without between forbid negation confirm confirmation",
        ),
        Situation(
            "match an event only if another has never happened before",
            "P fnot R",
            "explore(Room) <- enters(Room) fnot mapped(Room).",
            f"{_LANGUAGE}/cnot.md",
            "not first never negation before new unknown",
        ),
    ),
    "Several events": (
        Situation(
            "match an event that follows another",
            "P seq Q",
            "carried(G) <- grasp(G) seq lift(G).",
            f"{_LANGUAGE}/seq.md",
            "after then order sequence next followed before",
        ),
        Situation(
            "combine two sensors in any order",
            "(P and Q) within N",
            "visitor <- (near and loud) within 2.",
            "how-to/combine-sensors.md",
            "fusion both pair together approximate synchronize message_filters agree",
        ),
        Situation(
            "react to either of two events",
            "P or Q",
            "stop <- bumper or button.",
            f"{_LANGUAGE}/and-or.md",
            "alternative any one",
        ),
        Situation(
            "limit the time from the first to the last event",
            "P within N",
            "tap2 <- (tap seq tap) within 0.5.",
            f"{_LANGUAGE}/conditions.md",
            "window duration seconds double click fast",
        ),
        Situation(
            "match all waiting events, not only one",
            "P forall_seq Q",
            "delivered(L) <- loaded(L) forall_seq arrived.",
            f"{_LANGUAGE}/seq.md",
            "all collect batch",
        ),
        Situation(
            "pair each event with every partner instead of the newest",
            "property(policy, unrestricted)",
            "all([property(policy, unrestricted)]) : near(A, B) <- (at(A) and at(B)) within 1.",
            f"{_LANGUAGE}/policies.md",
            "all combinations consumption policy partner missed pairs reuse",
        ),
        Situation(
            "serve the oldest waiting event first",
            "property(policy, chronological)",
            "queue([property(policy, chronological)]) : served(O) <- order(O) seq tray.",
            f"{_LANGUAGE}/policies.md",
            "fifo queue first in out consumption policy order",
        ),
        Situation(
            "emit only matches of a rule that do not overlap",
            "property(after_match, skip_past_last)",
            "once([property(after_match, skip_past_last)]) : alarm <- slip ntimes 3.",
            f"{_LANGUAGE}/after-match.md",
            "duplicate double twice overlapping once skip repeated",
        ),
    ),
    "Intervals": (
        Situation(
            "know that two activities overlap in time",
            "P par Q",
            "curve <- driving par turning.",
            f"{_LANGUAGE}/intervals.md",
            "parallel same time concurrent simultaneous while",
        ),
        Situation(
            "know that something happened during an activity",
            "P during Q",
            "bumped_on(T) <- bump during tour(T).",
            f"{_LANGUAGE}/intervals.md",
            "while within inside contains",
        ),
        Situation(
            "know that one activity begins exactly when another ends",
            "P meets Q",
            "handover <- gives meets takes.",
            f"{_LANGUAGE}/intervals.md",
            "adjacent starts finishes equals allen relation touch",
        ),
        Situation(
            "measure how long something took",
            "P check (t1(S), t2(E), D is E - S)",
            "long(X, D) <- task(X) check (t1(S), t2(E), D is E - S, D > 10).",
            f"{_LANGUAGE}/conditions.md",
            "duration length start end time elapsed slow",
        ),
    ),
    "Repetition and counts": (
        Situation(
            "react to the third failure",
            "P ntimes 3",
            "help(X) <- (failed(X) ntimes 3) within 60.",
            f"{_LANGUAGE}/repetition.md",
            "count times repeated attempts again retry row",
        ),
        Situation(
            "count attempts and reset the counter",
            "P do Goal",
            "(missed where (misses(M), N is M + 1)) do (retractall(misses(_)), assertz(misses(N))).",
            "how-to/count-attempts.md",
            "retry counter failures backoff give up number",
        ),
        Situation(
            "count everything since an event",
            "P seq aggregate(count, Q, N)",
            "steps(N) <- walk seq aggregate(count, step, N).",
            f"{_LANGUAGE}/repetition.md",
            "sum collect number total star_times",
        ),
        Situation(
            "match values that fall several times in a row",
            "aggregate(K, Q, R, steps([...]))",
            "falling(A, B) <- aggregate([first(T), last(T)], temp(T), [A, B], steps([fall(3) where T < prev(T)])).",
            f"{_LANGUAGE}/steps.md",
            "trend rising falling pattern consecutive previous monotone match_recognize decrease increase",
        ),
    ),
    "Windows and statistics": (
        Situation(
            "average a value over the last N seconds",
            "aggregate(avg(X), Q, R, last(N))",
            "mean(M, A) <- aggregate(avg(T), temperature(M, T), A, last(60)).",
            "how-to/average-over-window.md",
            "mean moving smooth filter sliding window noise",
        ),
        Situation(
            "find the largest or smallest of recent values",
            "aggregate([min(X), max(X)], Q, R, W)",
            "span(A, B) <- aggregate([min(T), max(T)], temp(T), [A, B], last(3, events)).",
            f"{_LANGUAGE}/windows.md",
            "maximum minimum peak range extremes highest lowest",
        ),
        Situation(
            "count events in the last minute",
            "aggregate(count, Q, N, last(60))",
            "busy(N) <- aggregate(count, request, N, last(60)) where N >= 3.",
            f"{_LANGUAGE}/windows.md",
            "number how many often frequency per minute",
        ),
        Situation(
            "get one summary each minute",
            "aggregate(K, Q, R, every(60))",
            "load(R, N) <- aggregate(count, task(R), N, every(60)).",
            f"{_LANGUAGE}/windows.md",
            "report tumbling periodic batch per interval statistics",
        ),
        Situation(
            "detect a topic that is too slow",
            "aggregate([count, rate], Q, [C, Hz], last(C, events))",
            "slow(Hz) <- aggregate([count, rate], frame, [11, Hz], last(11, events)) where Hz < 8.",
            "how-to/slow-topic.md",
            "rate frequency hz fps camera publish",
        ),
        Situation(
            "ignore outliers",
            "aggregate(median(X), Q, R, W)",
            "level(M) <- aggregate(median(X), reading(X), M, last(5, events)).",
            f"{_LANGUAGE}/windows.md",
            "median quantile percentile robust spike filter outlier",
        ),
        Situation(
            "compare the newest value with an older one",
            "aggregate([first(X), last(X)], Q, R, W)",
            "rise(D) <- aggregate([first(T), last(T)], temp(T), [A, B], last(60)) where (D is B - A, D > 5).",
            f"{_LANGUAGE}/windows.md",
            "difference change previous before delta progress stuck trend",
        ),
        Situation(
            "collect recent values in a list",
            "aggregate(list(X), Q, L, W)",
            "seen(L) <- aggregate(list(X), marker(X), L, last(10)).",
            f"{_LANGUAGE}/windows.md",
            "distinct different unique set all buffer",
        ),
    ),
    "Rates and changes": (
        Situation(
            "alert at most every N seconds",
            "P with throttle(N)",
            "alert(M) <- hot(M) with throttle(10, M).",
            "how-to/limit-alerts.md",
            "limit rate repeat too many often flood spam throttle once",
        ),
        Situation(
            "debounce a button",
            "P with debounce(N)",
            "settled(X) <- slider(X) with debounce(0.5).",
            "how-to/debounce.md",
            "bounce settle stable contact switch last burst quiet",
        ),
        Situation(
            "react only to the first event of a burst",
            "P with burst(N)",
            "knocked <- knock with burst(2).",
            f"{_LANGUAGE}/rates.md",
            "first once group leading edge",
        ),
        Situation(
            "react only if a value changes",
            "P with change(X)",
            "mode(R, M) <- report(R, M) with change(M, R).",
            f"{_LANGUAGE}/rates.md",
            "different new same repeated duplicate distinct edge transition",
        ),
        Situation(
            "switch at two limits without flicker",
            "P with change(X)",
            "fan(S) <- wanted(S) with change(S).",
            "how-to/noisy-threshold.md",
            "hysteresis threshold noise noisy schmitt",
        ),
        Situation(
            "know that a robot enters or leaves a room",
            "P with change(Zone)",
            "entered(Z) <- in_zone(Z) with change(Z).",
            "how-to/enter-zone.md",
            "zone area region geofence leave exit position",
        ),
        Situation(
            "detect that a robot is stuck",
            "a window and a state",
            "still <- aggregate([first(X), last(X)], odom(X), [A, B], last(3)) where abs(B - A) < 0.04.",
            "how-to/stuck-robot.md",
            "blocked move moving progress wheels slip gripper",
        ),
    ),
    "States": (
        Situation(
            "know whether something holds now",
            "state(S, from(F), until(U)), holds(S)",
            ":- state(docked(R), from(dock(R)), until(undock(R))).",
            f"{_LANGUAGE}/state.md",
            "mode status flag remember fluent current while on off",
        ),
        Situation(
            "know since when a robot has been in a state",
            "holds(S, Since)",
            "long(R) <- tick check (t2(E), holds(driving(R), Since), E - Since > 600).",
            f"{_LANGUAGE}/state.md",
            "duration how long start began",
        ),
        Situation(
            "know what held at an earlier time",
            "holds_at(S, T)",
            "was_docked(R) <- bump(R, T) where holds_at(docked(R), T).",
            f"{_LANGUAGE}/state.md",
            "past history then when earlier",
        ),
        Situation(
            "stop until a reset",
            "state(stopped, from(stop), until(go))",
            ":- state(stopped, from(stop), until(go)).",
            "how-to/noisy-threshold.md",
            "latch emergency button hold release",
        ),
    ),
    "Time": (
        Situation(
            "do something every N seconds",
            "timer(E, every(N))",
            ":- timer(tick, every(10)).",
            f"{_LANGUAGE}/timer.md",
            "periodic cron schedule clock interval loop poll",
        ),
        Situation(
            "do something after a delay",
            "timer(E, after(N))",
            "missed do timer(again, after(2)) <- failed.",
            f"{_LANGUAGE}/timer.md",
            "later wait sleep alarm schedule postpone",
        ),
        Situation(
            "do something at a time of the day",
            "timer(E, at(Hour, Minute, Second))",
            ":- timer(good_night, at(22, 0, 0)).",
            f"{_LANGUAGE}/timer.md",
            "daily clock cron schedule date night morning",
        ),
        Situation(
            "compare or subtract timestamps",
            "D is T2 - T1",
            "?- D is datime(2026,11,22,9,30,10) - datime(2026,11,22,9,30,0).",
            "reference/memories.md",
            "difference seconds datime stamp header arithmetic",
        ),
        Situation(
            "accept events that arrive late",
            "property(out_of_order, on)",
            "late([property(out_of_order, on)]) : passed <- opened seq closed.",
            f"{_LANGUAGE}/order.md",
            "delay disorder order network latency unordered",
        ),
        Situation(
            "retract an event that was wrong",
            "rev(E)",
            ":- set_etalis_flag(revision_flag, on).",
            f"{_LANGUAGE}/revision.md",
            "retract take back undo correct revise withdraw false",
        ),
    ),
    "Memory and poses": (
        Situation(
            "remember events",
            "memorize(Pattern, Conditions, Record, Id, Size)",
            ":- memorize(seen(N, P), [], seen(N, P), sightings, 1000).",
            "reference/memories.md",
            "store history keep buffer log memory past",
        ),
        Situation(
            "find where an object was seen last",
            "newest_matching(Id, Record, T1, T2)",
            "at(N, P) <- asked(N) where newest_matching(sightings, seen(N, P), _, _).",
            "how-to/last-place.md",
            "object place location latest newest recent world model",
        ),
        Situation(
            "find what was known at an instant",
            "prev(Id, Record, T1, T2, T)",
            "?- prev(rooms, at(Room), _, _, 5).",
            "reference/memories.md",
            "before time lookup past next_inf history",
        ),
        Situation(
            "get a transform at the time of a picture",
            "synchronized(Event, Query, [[Id, T]])",
            "synchronized(pose(M, P), pose_chain([odom], T, P), [[odom, T]]) <- marker(M, T).",
            "how-to/transform-at-time.md",
            "tf interpolate camera image frame pose wait",
        ),
        Situation(
            "transform a pose between any two frames of /tf",
            "tf_transform(Pose, From, To, Time, Out)",
            "synchronized(at(P), tf_transform(R, camera, map, T, P), [[tf(map, camera), T]]) <- marker(R, T).",
            "reference/transforms.md",
            "tf tf2 lookup frame tree coordinates tf_lookup robot camera",
        ),
        Situation(
            "wait for data before a query is answered",
            "synchronized(Event, Query, [[Id, T]], [timeout(N)])",
            "synchronized(found(M), at(T, M), [[odom, T]], [timeout(2)]) <- marker(M, T).",
            f"{_LANGUAGE}/synchronized.md",
            "delay later sync postpone timeout",
        ),
        Situation(
            "interpolate between two records",
            "datime_interpolate(T1, T2, T, F)",
            "?- datime_interpolate(10, 12, 11, F).",
            "reference/memories.md",
            "between linear weight pose slerp",
        ),
        Situation(
            "refuse to interpolate over a gap",
            "set_etalis_flag(max_gap, Seconds)",
            ":- set_etalis_flag(max_gap, 0.5).",
            f"{_LANGUAGE}/synchronized.md",
            "hole drop missing data extrapolate",
        ),
    ),
    "Sensors": (
        Situation(
            "know that an obstacle is ahead",
            "array_slice(A, Start, End, B), array_min(B, D, Options)",
            "near(D) <- sensor_msgs__0__LaserScan{ranges: R} where "
            "(array_slice(R, 500, 580, A), array_min(A, D, [skip(nan)]), D < 0.5).",
            "reference/sensors.md",
            "scan laser lidar range distance nearest collision close bumper minimum array",
        ),
        Situation(
            "know that a camera image is dark",
            "image_region_mean(Image, X, Y, Width, Height, Mean)",
            "dark <- sensor_msgs__0__Image{} where "
            "(access_mem(camera, I, _), image_region_mean(I, 0, 0, 640, 480, M), M < 40).",
            "reference/sensors.md",
            "light bright brightness pixel picture depth colour average region",
        ),
        Situation(
            "know that something is in a zone of a point cloud",
            "cloud_box(Cloud, Min, Max, Count)",
            "taken(N) <- sensor_msgs__0__PointCloud2{} where "
            "(access_mem(cloud, C, _), cloud_box(C, [1,-1,0], [2,1,2], N), N > 9).",
            "reference/sensors.md",
            "pointcloud lidar velodyne kinect depth points box near person occupied obstacle",
        ),
        Situation(
            "know that a cell of a map is occupied",
            "map_cell(Map, X, Y, Value)",
            "blocked(X, Y) <- goal(X, Y) where (access_mem(map, M, _), map_cell(M, X, Y, V), V > 65).",
            "reference/sensors.md",
            "occupancygrid grid costmap free unknown wall navigation goal obstacle",
        ),
        Situation(
            "know that a joint needs too much effort",
            "aggregate(avg(Effort), Q, Mean, last(N))",
            "strained(J) <- aggregate(avg(F), effort(J, F), M, last(2)) where M > 6.",
            f"{_LANGUAGE}/windows.md",
            "motor torque current load window mean arm gripper",
        ),
    ),
    "Conditions, actions and messages": (
        Situation(
            "filter events by a condition",
            "P where Goal",
            "hot(M) <- temperature(M, T) where T > 80.",
            f"{_LANGUAGE}/conditions.md",
            "if threshold limit greater less compare test",
        ),
        Situation(
            "call a goal or change a fact if a rule matches",
            "P do Goal",
            "served do retractall(open(_)) <- order.",
            f"{_LANGUAGE}/conditions.md",
            "action execute side effect assert retract fact",
        ),
        Situation(
            "emit one event for each element of a list",
            "P event_multiply Goal",
            "seen(T) <- scan(Ts) event_multiply member(T, Ts).",
            f"{_LANGUAGE}/conditions.md",
            "array each split loop all detections",
        ),
        Situation(
            "read only some fields of a message",
            "pkg__0__Type{field: X}",
            "hot(T) <- sensor_msgs__0__Temperature{temperature: T}.",
            f"{_LANGUAGE}/declared-events.md",
            "slot named field struct message type nested",
        ),
        Situation(
            "distinguish two topics of one type",
            'event="NAME" in pub_sub.xml',
            "stuck <- bumper_left(true) seq bumper_right(true).",
            "reference/program-files.md",
            "topic name same type rename distinguish tell apart",
        ),
        Situation(
            "publish a message",
            "subscribe(Pattern, Conditions, Format, Topic, Id)",
            ":- subscribe(fever(W), [], std_msgs__0__String(W), alarms, a1).",
            "reference/memories.md",
            "send output topic output_subscription",
        ),
        Situation(
            "find misspelt event names early",
            ":- event E",
            ":- event started(motor:atom), temperature(motor:atom, value:number).",
            f"{_LANGUAGE}/declared-events.md",
            "typo declare schema type check spelling",
        ),
        Situation(
            "call a Python function from a rule",
            "@foreign",
            "near(D) <- at(X, Y) where (distance(X, Y, D), D < 1).",
            "how-to/python-predicate.md",
            "python numpy library own predicate foreign",
        ),
        Situation(
            "use an existing Prolog knowledge base",
            "use_swi(File)",
            "$ retalis console --allow-swi",
            "how-to/swi-prolog.md",
            "swi ontology rdf clpfd chr reasoning constraint",
        ),
    ),
    "Programs and runs": (
        Situation(
            "see why a rule did not fire",
            "--explain",
            "$ retalis events --rules rules.txt --stream stream.txt --explain 'alarm(_)'",
            "how-to/why-no-match.md",
            "debug explain nothing happens silent match provenance",
        ),
        Situation(
            "find mistakes before a program runs",
            "retalis check",
            "$ retalis check --strict program",
            "reference/checks.md",
            "lint verify error warning syntax validate",
        ),
        Situation(
            "test a program in CI",
            "retalis check, retalis bag, Engine",
            "$ retalis bag day.bag --program program --times=relative",
            "how-to/test-in-ci.md",
            "unit regression pytest automatic continuous integration",
        ),
        Situation(
            "see a run on a timeline",
            "retalis plot",
            "$ retalis plot day.bag --program program -o run.html",
            "reference/bags.md",
            "draw picture visualize graph chart",
        ),
        Situation(
            "run a program over many bags",
            "retalis bag --jobs N",
            "$ retalis bag recordings --program program --jobs 4 --output results",
            "how-to/many-bags.md",
            "batch parallel cluster dask recordings offline rosbag s3 parquet",
        ),
        Situation(
            "limit the memory of a program",
            "property(ttl, N), within N",
            "m([property(ttl, 60)]) : mean(B, A) <- aggregate(avg(X), weight(B, X), A, last(3, events)).",
            "how-to/limit-memory.md",
            "leak grow bound keys expire ttl garbage",
        ),
        Situation(
            "limit the time of a goal",
            "--max-seconds, ~max_seconds",
            "$ retalis events --rules rules.txt --stream stream.txt --max-seconds 1",
            "explanation/security.md",
            "loop endless hang cpu inferences watchdog",
        ),
        Situation(
            "continue after a crash or restart",
            "~checkpoint, Engine.snapshot",
            "$ roslaunch retalis retalis.launch checkpoint:=/var/lib/robot/retalis.db",
            "how-to/survive-restart.md",
            "respawn save restore state persist reboot",
        ),
        Situation(
            "run two robots",
            "an argument or a namespace for each robot",
            "lost(Robot) <- heartbeat(Robot) seq absent(heartbeat(Robot), 2).",
            "how-to/two-robots.md",
            "fleet several multi namespace meeting",
        ),
        Situation(
            "move a program from the original retalis",
            "retalis check",
            "$ retalis check old_program",
            "how-to/move-from-original.md",
            "migrate port upgrade old c++ etalis",
        ),
    ),
}
"""Situations by their section of the page."""

"""Events on a socket: every line to everyone, once, whatever clients do."""

import contextlib
import json
import os
import random
import socket
import stat
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lightstage.errors import FormatError
from lightstage.operator import EventConfig, EventServer, serve_events
from tests.waiting import until

WAIT_S = 30.0


class Writing:
    """A journal that is written as a capture does: to the disk, then the listeners are told."""

    def __init__(self, root):
        self.root = root
        self.path = root / "journal.jsonl"
        self.path.touch()
        self.listeners = []
        self.last_id = 0
        self.lock = threading.Lock()

    def note(self, event="note", **facts):
        with self.lock, self.path.open("ab") as file:
            self.last_id += 1
            line = {"id": self.last_id, "event": event, **facts}
            file.write(json.dumps(line).encode() + b"\n")
            file.flush()
            for listener in self.listeners:
                listener(line)


class Client:
    def __init__(self, path, after=None):
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.socket.connect(str(path))
        self.socket.settimeout(WAIT_S)
        self.file = self.socket.makefile("rb")
        if after is not None:
            self.send({"after": after})

    def send(self, value):
        data = value if isinstance(value, bytes) else json.dumps(value).encode() + b"\n"
        self.socket.sendall(data)

    def line(self):
        return json.loads(self.file.readline())

    def until(self, last_id):
        """Ids up to one."""
        ids = []
        while not ids or ids[-1] < last_id:
            ids.append(self.line()["id"])
        return ids

    def rest(self):
        """Ids of all that comes until the server closes."""
        return [json.loads(raw)["id"] for raw in self.file]

    def close(self):
        self.file.close()
        self.socket.close()


@pytest.fixture
def writing(tmp_path, runtime):
    return Writing(tmp_path)


def accept(do, pattern=""):
    return None


@contextlib.contextmanager
def serving(writing, request=accept, **config):
    with EventServer(writing.path, request, EventConfig(**config)) as server:
        writing.listeners.append(server.receive)
        yield server


def test_lines_are_replayed_and_then_live(writing):
    for _ in range(5):
        writing.note()
    with serving(writing) as server:
        late, all_of_them = Client(server.path, 3), Client(server.path, 0)
        assert late.until(5) == [4, 5]
        writing.note("lit", pattern="x+")
        line = late.line()
        assert line == {"id": 6, "event": "lit", "pattern": "x+"}
        assert all_of_them.until(6) == [1, 2, 3, 4, 5, 6]


def test_many_clients_that_come_and_go_while_lines_are_written_miss_and_double_none(writing):
    lines, clients = 1500, 24
    got, failures = {}, []
    with serving(writing) as server:

        def follow(number):
            chance = random.Random(number)
            try:
                ids, after = [], 0
                while after < lines:  # goes and comes back several times
                    client = Client(server.path, after)
                    for _ in range(chance.randrange(1, 700)):
                        ids.append(client.line()["id"])
                        after = ids[-1]
                        if after == lines:
                            break
                    client.close()
                got[number] = ids
            except Exception as error:
                failures.append(error)

        threads = [threading.Thread(target=follow, args=(i,)) for i in range(clients)]
        writers = [
            threading.Thread(target=lambda: [writing.note(n=i) for i in range(lines // 3)])
            for _ in range(3)
        ]
        for thread in [*threads[::2], *writers, *threads[1::2]]:
            thread.start()
        for thread in [*threads, *writers]:
            thread.join(WAIT_S)
    assert failures == []
    assert got == {number: list(range(1, lines + 1)) for number in range(clients)}


def test_a_client_that_does_not_read_holds_nobody_up_and_can_still_have_every_line(writing):
    text = "t" * 10_000
    with serving(writing) as server:
        slow, quick = Client(server.path, 0), Client(server.path, 0)
        for _ in range(500):  # 5 MB: far more than all buffers between them
            writing.note(text=text)
        assert quick.until(500) == list(range(1, 501))
        waiting = [len(client.waiting) for client in server._clients.values()]
        assert max(waiting) < 1 << 17
        assert slow.until(500) == list(range(1, 501))


def test_clients_that_die_in_the_middle_disturb_nobody(writing):
    with serving(writing) as server:
        steady = Client(server.path, 0)
        for turn in range(30):
            victim = Client(server.path, 0)
            if turn % 3 == 1:
                victim.send(b'{"after"')
            writing.note(text="t" * 100_000 if turn % 3 == 2 else "")
            victim.close()
        assert steady.until(30) == list(range(1, 31))
        writing.note()
        assert steady.line()["id"] == 31
        # A line may be given before the server has seen that a client is gone.
        until(lambda: len(server._clients) == 1, WAIT_S)


def test_a_line_that_is_not_whole_or_not_on_the_disk_is_not_given(writing):
    writing.note()
    with serving(writing) as server:
        client = Client(server.path, 0)
        assert client.until(1) == [1]
        with writing.path.open("ab") as file:
            file.write(b'{"id": 2, "event": "frame"}\n{"id": 3, "ev')
        server._wake()
        client.send({"do": "pause"})
        assert client.line() == {"answer": "pause", "accepted": True}  # and nothing before it
        server.receive({"id": 2})
        assert client.line()["id"] == 2
        with writing.path.open("ab") as file:
            file.write(b'ent": "shot"}\n')
        server.receive({"id": 3})
        assert client.line() == {"id": 3, "event": "shot"}


def test_a_cut_line_of_an_earlier_process_is_passed_over(writing):
    writing.note()
    with writing.path.open("ab") as file:
        file.write(b'{"id": 2, "event": "fra\n')
    writing.last_id = 1
    writing.note("resume")
    with serving(writing) as server:
        client = Client(server.path, 0)
        assert client.until(2) == [1, 2]


def test_requests_are_passed_on_and_answered(writing):
    asked = []

    def request(do, pattern):
        asked.append((do, pattern))
        return None if do == "abort" else "no pattern is done yet"

    with serving(writing, request) as server:
        client = Client(server.path)
        client.send({"do": "retake", "pattern": "x+"})
        why = "no pattern is done yet"
        assert client.line() == {"answer": "retake", "accepted": False, "why": why}
        client.send({"do": "abort"})
        assert client.line() == {"answer": "abort", "accepted": True}
    assert asked == [("retake", "x+"), ("abort", "")]


@pytest.mark.parametrize(
    "bad",
    [b"{}", b"[]", b"no", b'{"after": "1"}', b'{"after": true}', b"\xff", b"[" * 3000, b"null"],
)
def test_what_is_no_request_is_answered_and_the_next_one_heard(writing, bad):
    writing.note()
    with serving(writing) as server:
        client = Client(server.path)
        client.send(bad + b"\n")
        answer = client.line()
        assert answer["accepted"] is False
        assert "after" in answer["why"]
        client.send({"after": 0})
        assert client.until(1) == [1]


def test_endless_requests_and_unread_answers_end_that_client_alone(writing):
    writing.note()
    with serving(writing) as server:
        endless, deaf, good = (Client(server.path) for _ in range(3))
        with contextlib.suppress(OSError):
            endless.send(b"x" * 100_000)
        with contextlib.suppress(OSError):
            for _ in range(100_000):
                deaf.send({"do": "pause"})
        good.send({"after": 0})
        assert good.until(1) == [1]
        with contextlib.suppress(ConnectionError):
            assert endless.file.read() == b""


def test_more_clients_than_allowed_are_told_so(writing):
    writing.note()
    with serving(writing, clients=2) as server:
        first, second = Client(server.path, 0), Client(server.path, 0)
        assert first.until(1) == second.until(1) == [1]
        third = Client(server.path)
        assert third.line()["why"] == "too many"
        assert third.file.readline() == b""
        first.close()
        second.send({"do": "pause"})  # answered after the first is gone
        assert second.line()["accepted"]
        assert Client(server.path, 0).until(1) == [1]


def test_the_socket_is_private_and_gone_at_the_end(writing):
    with serving(writing) as server:
        assert stat.S_IMODE(os.stat(server.path).st_mode) == 0o600
        assert stat.S_ISSOCK(os.stat(server.path).st_mode)
    assert not server.path.exists()
    server.receive({"id": 1})  # a listener that is called late harms nothing
    server.close()


def test_at_the_end_everyone_who_reads_gets_the_last_line(writing):
    for _ in range(10):
        last = writing.last_id
        with serving(writing) as server, ThreadPoolExecutor(5) as pool:
            clients = [Client(server.path, last) for _ in range(5)]
            for client in clients:
                client.send({"do": "pause"})
                assert client.line()["accepted"]
            read = [pool.submit(client.rest) for client in clients]
            for _ in range(20):
                writing.note(text="t" * 10_000)
            server.close()
            for ids in read:
                assert ids.result(WAIT_S) == list(range(last + 1, last + 21))


def test_a_client_that_never_reads_does_not_keep_the_end_from_coming(writing):
    with serving(writing, last_words_s=0.05) as server:
        deaf = Client(server.path, 0)
        for _ in range(100):
            writing.note(text="t" * 20_000)
    assert not server.path.exists()
    deaf.close()


def test_a_session_states_its_socket_in_the_journal(writing):
    writing.note("begin")
    with serve_events(writing, accept) as server:
        client = Client(server.path, 0)
        assert client.line()["event"] == "begin"
        assert client.line()["socket"] == str(server.path)
    assert writing.listeners == []


def test_no_journal_leaves_no_socket(tmp_path, runtime):
    with pytest.raises(FormatError):
        EventServer(tmp_path / "journal.jsonl", accept)
    assert not runtime.exists() or list(runtime.iterdir()) == []


STEP = st.one_of(
    st.tuples(st.just("write"), st.integers(1, 3)),
    st.tuples(st.just("tear"), st.just(0)),
    st.tuples(st.just("join"), st.integers(0, 12)),
    st.tuples(st.just("leave"), st.integers(0, 5)),
    st.tuples(st.just("read"), st.integers(0, 5)),
    st.tuples(st.just("again"), st.integers(0, 5)),
)


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.lists(STEP, max_size=25))
def test_any_order_of_lines_and_clients_gives_each_client_what_it_asked_for(
    tmp_path_factory, runtime, steps
):
    writing = Writing(tmp_path_factory.mktemp("s"))
    clients, got = [], []
    with serving(writing) as server:
        for step, number in steps:
            index = number % len(clients) if clients else 0
            if step == "write":
                for _ in range(number):
                    writing.note()
            elif step == "tear":  # half a line is there when somebody looks
                with writing.path.open("ab") as file:
                    file.write(b'{"id"')
                    file.flush()
                    server._wake()
                    file.truncate(file.tell() - 5)
            elif step == "join":
                clients.append(Client(server.path, number))
                got.append((number, []))
            elif clients and step == "leave":
                clients.pop(index).close()
                got.pop(index)
            elif (
                clients
                and step == "read"
                and writing.last_id > max([got[index][0], *got[index][1]])
            ):
                got[index][1].append(clients[index].line()["id"])
            elif clients and step == "again":
                after = max([got[index][0], *got[index][1]])
                clients[index].close()
                clients[index] = Client(server.path, after)
        for client, (after, ids) in zip(clients, got, strict=True):
            if writing.last_id > max([after, *ids]):
                ids += client.until(writing.last_id)
            assert ids == list(range(after + 1, writing.last_id + 1))
            client.close()

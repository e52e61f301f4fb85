//! Ptys as clients meet them: they come and go, are killed, leave things behind, do not read (BUS-23); links; speed and
//! stop bits (BUS-16).
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod program;

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use nix::sys::termios::BaudRate;
use program::{ANSWER, ASK, CHARGER, Program, SILENCE, charger_on_pty, framed, open, refused, until};

/// Longer than the program takes to notice on a busy machine that a client has gone.
const SETTLE: Duration = Duration::from_millis(300);

#[test]
fn bus_23_clients_come_and_go_without_end() {
    let program = Program::start(&charger_on_pty(""));
    for _ in 0..200 {
        open(&program.line()).expect_answer();
    }
    let mut clients: Vec<_> = (0..20).map(|_| open(&program.line())).collect();
    clients.pop().unwrap().expect_answer();
    drop(clients);
    open(&program.line()).expect_answer();
}

#[test]
fn bus_23_what_a_client_left_unread_does_not_reach_the_next() {
    let program = Program::start(&charger_on_pty(""));
    for round in 0..20 {
        let mut leaving = open(&program.line());
        leaving.send(&framed(&ASK).repeat(20));
        if round % 2 == 0 {
            leaving.receive(3, SILENCE);
        }
        drop(leaving);
        thread::sleep(SETTLE);
        let mut next = open(&program.line());
        let early = next.receive(1, Duration::from_millis(5));
        assert!(early.is_empty(), "round {round}: {early:?}");
        next.expect(&[4, 3, 0, 7, 0, 1], &[4, 3, 2, 0, 180]);
    }
}

#[test]
fn bus_23_what_a_client_left_half_sent_is_dropped() {
    // The silence that would drop it otherwise is ten seconds long.
    let program = Program::start(&charger_on_pty("slack_ms = 10_000"));
    for cut in 1..8 {
        open(&program.line()).send(&framed(&ASK)[..cut]);
        thread::sleep(SETTLE);
        let start = Instant::now();
        open(&program.line()).expect_answer();
        assert!(start.elapsed() < Duration::from_secs(5), "cut at {cut}: answered after {:?}", start.elapsed());
    }
}

#[test]
fn bus_23_what_a_client_left_half_sent_is_dropped_though_the_next_one_is_there_at_once() {
    let program = Program::start(&charger_on_pty(""));
    for round in 0..200 {
        open(&program.line()).send(&framed(&ASK)[..1 + round % 7]);
        let mut next = open(&program.line());
        if round % 2 == 0 {
            // A damaged frame of the first is nobody's to be answered (BUS-4).
            thread::sleep(Duration::from_millis(round as u64 % 40));
        }
        next.expect_answer();
        drop(next);
        thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn bus_23_a_whole_request_is_carried_out_though_its_client_has_gone() {
    let program = Program::start(&charger_on_pty(""));
    for limit in 231..=240 {
        // As `printf ... > link` does: the pty is closed before the reply is there.
        open(&program.line()).send(&framed(&[4, 6, 0, 6, 0, limit]));
        thread::sleep(SETTLE);
        open(&program.line()).expect(&[4, 3, 0, 6, 0, 1], &[4, 3, 2, 0, limit]);
    }
}

#[test]
fn bus_23_a_reply_on_its_way_to_a_client_that_has_gone_is_dropped() {
    let options = "options = { response_delay_ms = 500 }\n";
    let program = Program::start(&(charger_on_pty("") + options));
    open(&program.line()).send(&framed(&ASK));
    thread::sleep(SETTLE);
    let mut next = open(&program.line());
    let early = next.receive(1, Duration::from_millis(800));
    assert!(early.is_empty(), "{early:?}");
    next.expect_answer();
}

#[test]
fn many_ptys_find_room_in_what_the_system_gives() {
    let buses = (1..=64).map(|number| charger_on_pty("").replace("line1", &format!("line{number}")));
    let config: String =
        buses.enumerate().map(|(index, bus)| bus.replace("charger", &format!("charger{index}"))).collect();
    let program = Program::start(&config);
    for number in 1..=64 {
        open(&program.folder.path().join(format!("line{number}"))).expect_answer();
    }
}

/// A process that opens a port, sends bytes and waits.
fn talker(path: &Path, bytes: &[u8]) -> Child {
    let escaped: String = bytes.iter().map(|byte| format!("\\{byte:03o}")).collect();
    // The sleep takes the shell's place, so that killing it is killing the client.
    let script = "exec 3<>\"$0\" && printf \"$1\" >&3 && exec sleep 60";
    let mut command = Command::new("sh");
    command.args(["-c", script]).arg(path).arg(escaped).stdin(Stdio::null());
    command.spawn().unwrap()
}

#[test]
fn bus_23_killed_clients_leave_nothing_behind() {
    let program = Program::start(&charger_on_pty("slack_ms = 10_000"));
    for bytes in [&framed(&ASK)[..5], &framed(&ASK)[..], &framed(&ASK).repeat(3)[..20]] {
        let mut client = talker(&program.line(), bytes);
        thread::sleep(SETTLE);
        client.kill().unwrap();
        client.wait().unwrap();
        thread::sleep(SETTLE);
        let mut next = open(&program.line());
        let early = next.receive(1, Duration::from_millis(20));
        assert!(early.is_empty(), "{early:?}");
        next.expect_answer();
    }
}

#[test]
fn bus_23_a_second_client_is_not_disturbed_by_the_first_ones_end() {
    let program = Program::start(&charger_on_pty("slack_ms = 10_000"));
    // The kernel may merge what it has to tell of two clients that open in one moment.
    let mut staying = open(&program.line());
    for _ in 0..50 {
        let mut leaving = open(&program.line());
        leaving.expect_answer();
        staying.send(&framed(&ASK)[..4]);
        drop(leaving);
        thread::sleep(Duration::from_millis(5));
        staying.send(&framed(&ASK)[4..]);
        staying.expect_frame(&ANSWER);
    }
}

#[test]
fn bus_23_a_program_that_was_held_up_tells_the_next_client_from_the_last() {
    let program = Program::start(&charger_on_pty("slack_ms = 10_000"));
    let whole = framed(&ASK);
    let (half, both) = (whole[..5].to_vec(), [&whole[..], &whole[..5]].concat());
    for (left, asks_at_once) in
        [&whole, &half, &both, &Vec::new()].into_iter().flat_map(|left| [(left, false), (left, true)])
    {
        let mut last = open(&program.line());
        last.expect_answer();
        program.signal(Signal::SIGSTOP);
        thread::sleep(Duration::from_millis(20));
        last.send(left);
        drop(last);
        let mut next = open(&program.line());
        let question = framed(&[4, 3, 0, 7, 0, 1]);
        if asks_at_once {
            next.send(&question);
        }
        program.signal(Signal::SIGCONT);
        if !asks_at_once {
            next.expect_silence();
            next.send(&question);
        }
        next.expect_frame(&[4, 3, 2, 0, 180]);
        next.expect_silence();
    }
}

#[test]
fn bus_23_nothing_spins_when_nobody_is_there() {
    let program = Program::start(&charger_on_pty(""));
    for _ in 0..5 {
        open(&program.line()).send(&framed(&ASK));
    }
    thread::sleep(Duration::from_millis(200));
    let before = program.cpu();
    thread::sleep(Duration::from_secs(1));
    let spent = program.cpu() - before;
    assert!(spent < Duration::from_millis(100), "{spent:?} of a second");
}

#[test]
fn a_client_that_does_not_read_costs_neither_memory_nor_the_other_buses() {
    let second =
        format!("[[bus]]\nname = \"line2\"\nport = \"pty:{{dir}}/line2\"\n{CHARGER}").replace("charger", "two");
    let program = Program::start(&(charger_on_pty("") + &second));
    let mut other = open(&program.folder.path().join("line2"));
    other.expect_answer();
    let mut deaf = open(&program.line());
    let requests = framed(&ASK).repeat(500);
    deaf.send(&requests);
    let before = program.resident_kib();
    for _ in 0..100 {
        deaf.send(&requests);
        other.expect_answer();
    }
    let grown = program.resident_kib().saturating_sub(before);
    // 50,000 replies are 450 KB and more in any form that they could be kept in.
    assert!(grown < 300, "{grown} KiB for replies that nobody reads");
    thread::sleep(Duration::from_millis(100));
    let before = program.cpu();
    thread::sleep(Duration::from_millis(500));
    assert!(program.cpu() - before < Duration::from_millis(50), "it spins");
    // Replies that were kept are whole, and in order, up to where the room ended.
    let mut replies = 0;
    while deaf.receive(9, SILENCE) == framed(&ANSWER) {
        replies += 1;
    }
    assert!(replies >= 2000, "{replies} replies of 9 bytes: the kernel alone keeps 20,000 bytes");
    deaf.receive(1 << 20, SILENCE);
    deaf.expect_answer();
}

#[test]
fn bus_5_split_and_joined_requests_are_answered_in_order() {
    let program = Program::start(&charger_on_pty(""));
    let mut client = open(&program.line());
    for byte in framed(&ASK) {
        client.send(&[byte]);
        thread::sleep(Duration::from_millis(2));
    }
    client.expect_frame(&ANSWER);
    let requests: Vec<u8> = (0..12).flat_map(|register| framed(&[4, 3, 0, register, 0, 1])).collect();
    client.send(&requests);
    // The TRC's factory values (TRC-1), at unit 4 and 9600 baud with two stop bits.
    for value in [4_u16, 2, 1, 275, 20, 190, 250, 180, 285, 210, 40, 30] {
        let [high, low] = value.to_be_bytes();
        client.expect_frame(&[4, 3, 2, high, low]);
    }
    client.send(&[0xFF; 40]);
    thread::sleep(Duration::from_millis(60));
    client.expect_answer();
}

#[test]
fn bus_5_a_program_that_was_held_up_does_not_take_that_for_silence() {
    let program = Program::start(&charger_on_pty(""));
    let mut client = open(&program.line());
    let request = framed(&ASK);
    for _ in 0..5 {
        client.send(&request[..3]);
        thread::sleep(Duration::from_millis(5));
        program.signal(Signal::SIGSTOP);
        thread::sleep(Duration::from_millis(5));
        client.send(&request[3..6]);
        thread::sleep(Duration::from_millis(150));
        program.signal(Signal::SIGCONT);
        thread::sleep(Duration::from_millis(5));
        client.send(&request[6..]);
        client.expect_frame(&ANSWER);
    }
}

#[test]
fn links_are_made_with_their_folder_and_removed_at_every_kind_of_end() {
    for signal in [Signal::SIGTERM, Signal::SIGINT, Signal::SIGHUP] {
        let config = charger_on_pty("").replace("{dir}/line1", "{dir}/a/b c/line1");
        let mut program = Program::start(&config);
        let link = program.folder.path().join("a/b c/line1");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert!(fs::canonicalize(&link).unwrap().starts_with("/dev/pts"));
        program.signal(signal);
        assert_eq!(program.ended().code(), Some(0), "{signal}: {}", program.log());
        assert!(fs::symlink_metadata(&link).is_err(), "{signal} leaves the link");
    }
}

#[test]
fn the_link_of_a_killed_run_is_replaced() {
    let folder = Arc::new(tempfile::tempdir().unwrap());
    let mut killed = Program::start_in(folder.clone(), &charger_on_pty(""), &[]);
    let target = fs::read_link(killed.line()).unwrap();
    killed.signal(Signal::SIGKILL);
    killed.ended();
    assert_eq!(fs::read_link(killed.line()).unwrap(), target, "nobody was there to remove it");
    // Another program has taken its number since: that is why the number does not tell.
    let taken = nix::pty::openpty(None, None).unwrap();
    let program = Program::start_in(folder.clone(), &charger_on_pty(""), &[]);
    open(&program.line()).expect_answer();
    drop(taken);
    drop(program);
    fs::remove_file(folder.path().join("line1")).unwrap();
    symlink("/dev/pts/987654", folder.path().join("line1")).unwrap();
    open(&Program::start_in(folder, &charger_on_pty(""), &[]).line()).expect_answer();
}

#[test]
fn what_is_not_our_link_is_never_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("line1");
    let other = nix::pty::openpty(None, None).unwrap();
    let node = nix::unistd::ttyname(&other.slave).unwrap();
    let make: [(&str, &dyn Fn()); 4] = [
        ("a file", &|| fs::write(&path, "mine").unwrap()),
        ("a folder", &|| fs::create_dir(&path).unwrap()),
        ("a link to a file", &|| symlink("/etc/hostname", &path).unwrap()),
        ("another program's pty", &|| symlink(&node, &path).unwrap()),
    ];
    for (what, make) in make {
        let found = || {
            let found = fs::symlink_metadata(&path).unwrap();
            (found.file_type(), fs::read_link(&path).ok(), found.is_file().then(|| fs::read(&path).unwrap()))
        };
        make();
        let before = found();
        let (status, says) = refused(folder.path(), &charger_on_pty(""), &[]);
        assert_eq!((status, before), (1, found()), "{what}: {says}");
        assert!(says.contains(path.to_str().unwrap()) && says.contains("remove it"), "{what}: {says}");
        if path.is_dir() { fs::remove_dir(&path).unwrap() } else { fs::remove_file(&path).unwrap() }
    }
}

#[test]
fn a_link_that_a_running_program_holds_is_refused() {
    let first = Program::start(&charger_on_pty(""));
    let folder = first.folder.path();
    let second = charger_on_pty("").replace("line1", "other");
    let both = second.replace("charger", "other") + &charger_on_pty("");
    let (status, says) = refused(folder, &both, &[]);
    assert_eq!(status, 1, "{says}");
    assert!(says.contains("running program"), "{says}");
    assert!(fs::symlink_metadata(folder.join("other")).is_err(), "nothing is left half started");
    open(&first.line()).expect_answer();
    // By another name of the folder it is the same link.
    let alias = tempfile::tempdir().unwrap();
    symlink(folder, alias.path().join("alias")).unwrap();
    let (status, says) = refused(alias.path(), &charger_on_pty("").replace("{dir}", "{dir}/alias"), &[]);
    assert_eq!(status, 1, "{says}");
    open(&first.line()).expect_answer();
}

#[test]
fn a_link_that_was_replaced_meanwhile_is_left_alone() {
    let mut program = Program::start(&charger_on_pty(""));
    fs::remove_file(program.line()).unwrap();
    symlink("/dev/null", program.line()).unwrap();
    assert_eq!(program.end().code(), Some(0));
    assert_eq!(fs::read_link(program.line()).unwrap(), Path::new("/dev/null"));
}

#[test]
fn paths_that_cannot_be_links_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("file"), "").unwrap();
    for path in ["{dir}/file/line1", "/proc/line1", "/dev/null/line1"] {
        let (status, says) = refused(folder.path(), &charger_on_pty("").replace("{dir}/line1", path), &[]);
        assert_eq!(status, 1, "{path}: {says}");
        assert!(says.contains("line1"), "{path}: {says}");
    }
}

#[test]
fn a_signal_waits_for_the_reply_that_is_under_way() {
    let mut program = Program::start(&(charger_on_pty("") + "options = { response_delay_ms = 400 }\n"));
    let mut client = open(&program.line());
    client.send(&framed(&ASK));
    thread::sleep(Duration::from_millis(100));
    program.signal(Signal::SIGTERM);
    client.expect_frame(&ANSWER);
    assert_eq!(program.ended().code(), Some(0));
}

#[test]
fn the_program_ends_with_the_one_that_started_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = program::command(folder.path(), &charger_on_pty(""), &["--exit-with-parent"]);
    // A shell in between is the parent; it tells the child's number and waits.
    let mut shell = Command::new("sh");
    shell.args(["-c", "\"$0\" \"$@\" >\"$OUT\" & echo $!; wait"]).arg(command.get_program()).args(command.get_args());
    shell.env("OUT", folder.path().join("out")).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
    command = shell;
    let mut parent = command.spawn().unwrap();
    let link = folder.path().join("line1");
    until("it is ready", || fs::read_to_string(folder.path().join("out")).is_ok_and(|text| text.contains("ready")));
    open(&link).expect_answer();
    parent.kill().unwrap();
    parent.wait().unwrap();
    until("the link is removed", || fs::symlink_metadata(&link).is_err());
}

#[test]
fn bus_16_enforce_leaves_a_client_at_the_wrong_speed_alone() {
    let program = Program::start(&charger_on_pty("line_check = \"enforce\""));
    let mut client = open(&program.line());
    // Nothing set: the pty starts with the bus' settings.
    client.expect_answer();
    client.configure(BaudRate::B19200, 2);
    client.send(&framed(&ASK));
    client.expect_silence();
    program.logs("19200 baud, 2 stop bits; charger is set to 9600 8N2");
    client.configure(BaudRate::B9600, 2);
    client.expect_answer();
    // The TRC's register 1 at 4 is 19200 baud (TRC-4): the reply still comes at the old speed (BUS-13).
    client.expect(&[4, 6, 0, 1, 0, 4], &[4, 6, 0, 1, 0, 4]);
    client.send(&framed(&ASK));
    client.expect_silence();
    client.configure(BaudRate::B19200, 2);
    client.expect_answer();
}

#[test]
fn bus_16_warn_answers_and_warns_once_for_each_client() {
    let program = Program::start(&charger_on_pty(""));
    let warnings = || program.log().matches("the client talks 4800 baud, 1 stop bits; charger").count();
    for clients in 1..=3 {
        let mut client = open(&program.line());
        client.configure(BaudRate::B4800, 1);
        client.expect_answer();
        client.expect_answer();
        until("it is warned", || warnings() == clients);
        client.expect_answer();
        drop(client);
        thread::sleep(SETTLE);
    }
    assert_eq!(warnings(), 3);
}

#[test]
fn bus_16_off_says_nothing() {
    let program = Program::start(&charger_on_pty("line_check = \"off\""));
    let mut client = open(&program.line());
    client.configure(BaudRate::B4800, 1);
    client.expect_answer();
    thread::sleep(Duration::from_millis(50));
    assert!(!program.log().contains("4800"), "{}", program.log());
}

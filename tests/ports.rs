//! Ports beside the pty: serial lines, RTU over TCP, Modbus TCP; an independent master; the line's own time (BUS-17) and
//! other slaves on it (BUS-6).
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod program;

use std::fs::{self, File};
use std::ops::{Deref, DerefMut};
use std::os::fd::OwnedFd;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use nix::fcntl::OFlag;
use nix::pty::{grantpt, posix_openpt, ptsname_r, unlockpt};
use program::{ANSWER, ASK, CHARGER, Client, PATIENCE, Program, SILENCE, connect, framed, open, refused, until};
use tokio_modbus::client::rtu;
use tokio_modbus::prelude::{Client as _, ExceptionCode, Reader as _, Slave, SlaveContext as _, Writer as _};

/// A bus with these ports and the TRC.
fn charger_on(ports: &str) -> String {
    format!("[[bus]]\nname = \"line1\"\nports = [{ports}]\n{CHARGER}")
}

/// A serial line whose one end is at a path, as an adapter's would be, and the other ours. Dropping it pulls it out.
struct Line {
    ours: Client<File>,
    /// Open until the program has opened it too: a line that nobody has open is hung up.
    _theirs: File,
}

impl Line {
    fn at(path: &Path) -> Self {
        // Closed for the programs that tests start meanwhile: what one of them held could not be pulled out.
        let flags = OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_NONBLOCK | OFlag::O_CLOEXEC;
        let master = posix_openpt(flags).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let node = ptsname_r(&master).unwrap();
        let _ = fs::remove_file(path);
        symlink(&node, path).unwrap();
        Self { ours: Client { port: File::from(OwnedFd::from(master)) }, _theirs: open(path).port }
    }
}

impl Deref for Line {
    type Target = Client<File>;

    fn deref(&self) -> &Self::Target {
        &self.ours
    }
}

impl DerefMut for Line {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.ours
    }
}

#[test]
fn an_independent_master_reads_and_writes_on_a_pty() {
    let program = Program::start(&charger_on("\"pty:{dir}/line1\""));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let path = program.line();
        let builder = tokio_serial::new(path.to_str().unwrap(), 9600).stop_bits(tokio_serial::StopBits::Two);
        let mut master = rtu::attach_slave(tokio_serial::SerialStream::open(&builder).unwrap(), Slave(4));
        // The TRC's factory values (TRC-1), at unit 4 and 9600 baud with two stop bits.
        let factory = [4, 2, 1, 275, 20, 190, 250, 180, 285, 210, 40, 30];
        assert_eq!(master.read_holding_registers(0, 12).await.unwrap().unwrap(), factory);
        master.write_single_register(6, 240).await.unwrap().unwrap();
        master.write_multiple_registers(10, &[45, 25]).await.unwrap().unwrap();
        assert_eq!(master.read_holding_registers(6, 6).await.unwrap().unwrap(), [240, 180, 285, 210, 45, 25]);
        assert_eq!(master.read_input_registers(0, 2).await.unwrap().unwrap(), [0, 230]);
        assert_eq!(master.read_coils(0, 11).await.unwrap().unwrap().len(), 11);
        // BUS-8: no such address, a value out of range (TRC-5), no such function (TRC-1).
        assert_eq!(master.read_holding_registers(11, 2).await.unwrap(), Err(ExceptionCode::IllegalDataAddress));
        assert_eq!(master.write_single_register(6, 229).await.unwrap(), Err(ExceptionCode::IllegalDataValue));
        assert_eq!(master.write_single_coil(0, true).await.unwrap(), Err(ExceptionCode::IllegalFunction));
        // BUS-2: nobody answers for another unit, and the next request is answered.
        master.set_slave(Slave(5));
        tokio::time::timeout(SILENCE, master.read_holding_registers(0, 1)).await.unwrap_err();
        master.disconnect().await.unwrap();
    });
    // What it wrote holds for the next client.
    open(&program.line()).expect(&[4, 3, 0, 6, 0, 1], &[4, 3, 2, 0, 240]);
}

#[test]
fn clients_of_a_tcp_port_have_each_their_own_framing() {
    let program = Program::start(&charger_on("\"tcp:127.0.0.1:0\", \"pty:{dir}/line1\""));
    let address = program.address(0, 0);
    let mut clients: Vec<_> = (0..8).map(|_| connect(&address)).collect();
    for cut in 1..8 {
        for client in &mut clients {
            client.send(&framed(&ASK)[..cut]);
        }
        for client in &mut clients {
            client.send(&framed(&ASK)[cut..]);
        }
        for client in &mut clients {
            client.expect_frame(&ANSWER);
        }
    }
    // All doors lead to one bus.
    clients[0].expect(&[4, 6, 0, 6, 0, 240], &[4, 6, 0, 6, 0, 240]);
    clients[7].expect(&[4, 3, 0, 6, 0, 1], &[4, 3, 2, 0, 240]);
    open(&program.line()).expect(&[4, 3, 0, 6, 0, 1], &[4, 3, 2, 0, 240]);
}

#[test]
fn a_client_that_only_listens_any_more_still_gets_its_reply() {
    let delayed = charger_on("\"tcp:127.0.0.1:0\"") + "options = { response_delay_ms = 200 }\n";
    let program = Program::start(&delayed);
    let mut client = connect(&program.address(0, 0));
    client.send(&framed(&ASK).repeat(2));
    client.port.shutdown(std::net::Shutdown::Write).unwrap();
    client.expect_frame(&ANSWER);
    client.expect_frame(&ANSWER);
    let start = Instant::now();
    assert!(client.receive(1, PATIENCE).is_empty() && start.elapsed() < PATIENCE, "then the program closes, too");
}

/// A request of Modbus TCP.
fn transaction(number: u16, body: &[u8]) -> Vec<u8> {
    let header = [number, 0, body.len() as u16].map(u16::to_be_bytes);
    [header.as_flattened(), body].concat()
}

#[test]
fn modbus_tcp_answers_what_is_pipelined_in_order_and_by_its_transaction() {
    let second = CHARGER.replace("charger", "second").replace("unit = 4", "unit = 9");
    let program = Program::start(&(charger_on("\"modbus-tcp:127.0.0.1:0\"") + &second));
    let mut client = connect(&program.address(0, 0));
    client.send(&transaction(7, &[9, 6, 0, 6, 0, 240]));
    assert_eq!(client.receive(12, PATIENCE), transaction(7, &[9, 6, 0, 6, 0, 240]));
    // More than may wait at a door, in pieces that do not end where requests do.
    let body = |number: u16| if number.is_multiple_of(3) { [9, 3, 0, 6, 0, 1] } else { [4, 3, 0, 6, 0, 1] };
    let requests: Vec<u8> = (0..2000).flat_map(|number| transaction(number, &body(number))).collect();
    let mut writer = Client { port: client.port.try_clone().unwrap() };
    let sender = thread::spawn(move || requests.chunks(1021).for_each(|piece| writer.send(piece)));
    for number in 0..2000 {
        let value = if number % 3 == 0 { 240 } else { 250 };
        assert_eq!(client.receive(11, PATIENCE), transaction(number, &[body(number)[0], 3, 2, 0, value]));
    }
    sender.join().unwrap();
    // Refusals (BUS-8), and silence for a unit that nobody has (BUS-2).
    client.send(&transaction(1, &[4, 3, 0, 99, 0, 1]));
    assert_eq!(client.receive(9, PATIENCE), transaction(1, &[4, 0x83, 2]));
    client.send(&transaction(2, &[5, 3, 0, 6, 0, 1]));
    client.expect_silence();
}

#[test]
fn modbus_tcp_waits_for_a_slow_client_and_loses_nothing() {
    let program = Program::start(&charger_on("\"modbus-tcp:127.0.0.1:0\", \"pty:{dir}/line1\""));
    let mut client = connect(&program.address(0, 0));
    let mut writer = Client { port: client.port.try_clone().unwrap() };
    let count = 30_000_u16;
    let sender = thread::spawn(move || {
        let requests: Vec<u8> = (0..count).flat_map(|number| transaction(number, &[4, 3, 0, 0, 0, 12])).collect();
        writer.send(&requests);
    });
    // It reads nothing for a while: a megabyte of replies has no room anywhere but in the requests not read yet.
    thread::sleep(Duration::from_millis(300));
    open(&program.line()).expect_answer();
    assert!(program.resident_kib() < 40_000, "{} KiB", program.resident_kib());
    for number in 0..count {
        let reply = client.receive(33, PATIENCE);
        assert_eq!(reply[..2], number.to_be_bytes());
    }
    sender.join().unwrap();
}

#[test]
fn modbus_tcp_closes_on_those_who_talk_something_else() {
    let program = Program::start(&charger_on("\"modbus-tcp:127.0.0.1:0\""));
    for nonsense in
        [&b"GET / HTTP/1.1\r\n\r\n"[..], &[0, 1, 0, 0, 0, 1, 4], &[0, 1, 0, 0, 1, 0, 4], &[0, 1, 0, 1, 0, 6, 4]]
    {
        let mut client = connect(&program.address(0, 0));
        client.send(nonsense);
        let start = Instant::now();
        assert!(
            client.receive(1, PATIENCE).is_empty() && start.elapsed() < PATIENCE,
            "{nonsense:?} keeps its connection"
        );
        // What was asked before it, in the same breath, is answered.
        let mut client = connect(&program.address(0, 0));
        client.send(&[transaction(2, &ASK), nonsense.to_vec()].concat());
        assert_eq!(client.receive(13, PATIENCE), transaction(2, &ANSWER));
        assert!(client.receive(1, PATIENCE).is_empty() && start.elapsed() < PATIENCE);
    }
    let mut client = connect(&program.address(0, 0));
    client.send(&transaction(3, &ASK));
    assert_eq!(client.receive(13, PATIENCE), transaction(3, &ANSWER));
}

#[test]
fn a_port_takes_so_many_clients_and_new_ones_when_some_have_gone() {
    for (max_clients, limit) in [("", 64), ("max_clients = 3", 3)] {
        turns_away_above(max_clients, limit);
    }
}

#[track_caller]
fn turns_away_above(max_clients: &str, limit: usize) {
    let program = Program::start(&charger_on("\"tcp:127.0.0.1:0\"").replace("ports", &format!("{max_clients}\nports")));
    let address = program.address(0, 0);
    let mut clients: Vec<_> = (0..limit).map(|_| connect(&address)).collect();
    clients[limit - 1].expect_answer();
    let mut refused = connect(&address);
    let start = Instant::now();
    assert!(refused.receive(1, PATIENCE).is_empty() && start.elapsed() < PATIENCE, "one more is turned away");
    program.logs(&format!("max_clients = {limit} are there already"));
    clients.truncate(limit / 2);
    until("there is room", || {
        let mut client = connect(&address);
        client.send(&framed(&ASK));
        client.reply_or_end(9).is_some_and(|reply| reply == framed(&ANSWER))
    });
}

#[test]
fn an_address_that_is_taken_is_an_error() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap();
    let folder = tempfile::tempdir().unwrap();
    for kind in ["tcp", "modbus-tcp"] {
        let config = charger_on(&format!("\"pty:{{dir}}/line1\", \"{kind}:{address}\""));
        let (status, says) = refused(folder.path(), &config, &[]);
        assert_eq!(status, 1, "{says}");
        assert!(says.contains(&format!("{kind}:{address}")), "{says}");
        assert!(fs::symlink_metadata(folder.path().join("line1")).is_err(), "nothing is left half started");
    }
}

#[test]
fn a_serial_port_that_fails_comes_back_and_the_other_buses_never_notice() {
    let folder = std::sync::Arc::new(tempfile::tempdir().unwrap());
    let adapter = folder.path().join("ttyUSB0");
    let mut line = Line::at(&adapter);
    let second =
        format!("[[bus]]\nname = \"line2\"\nport = \"pty:{{dir}}/line2\"\n{CHARGER}").replace("charger", "two");
    let config = charger_on("\"serial:{dir}/ttyUSB0\"") + &second;
    let program = Program::start_in(folder.clone(), &config, &[]);
    let mut other = open(&folder.path().join("line2"));
    line.expect_answer();
    line.expect(&[4, 6, 0, 6, 0, 240], &[4, 6, 0, 6, 0, 240]);
    // Pulled out.
    drop(line);
    fs::remove_file(&adapter).unwrap();
    program.logs("failed");
    let before = program.cpu();
    for _ in 0..100 {
        other.expect_answer();
        thread::sleep(Duration::from_millis(10));
    }
    assert!(program.cpu() - before < Duration::from_millis(300), "it spins");
    // Put back: what the devices were told is still so.
    let mut line = Line::at(&adapter);
    program.logs("is back");
    line.expect(&[4, 3, 0, 6, 0, 1], &[4, 3, 2, 0, 240]);
}

#[test]
fn a_serial_port_that_cannot_be_opened_or_does_not_take_its_settings_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("file"), "").unwrap();
    for path in ["{dir}/nothing", "{dir}/file", "{dir}"] {
        let (status, says) = refused(folder.path(), &charger_on(&format!("\"serial:{path}\"")), &[]);
        assert_eq!(status, 1, "{path}: {says}");
        assert!(says.contains("serial:"), "{path}: {says}");
    }
    // The kernel keeps no parity for ptys, so one stands for an adapter that has none.
    let _line = Line::at(&folder.path().join("ttyUSB0"));
    let config = "[[bus]]\nname = \"line1\"\nport = \"serial:{dir}/ttyUSB0\"\nparity = \"even\"\nstop_bits = 1\n\
                  [[bus.device]]\nname = \"relay\"\nmodel = \"logiccon-pfc24s-tcr\"\nunit = 1\n";
    let (status, says) = refused(folder.path(), config, &[]);
    assert_eq!(status, 1, "{says}");
    assert!(says.contains("does not take 9600 8E1"), "{says}");
}

#[test]
fn bus_6_polls_beside_other_slaves_are_all_answered_and_none_for_others() {
    let folder = std::sync::Arc::new(tempfile::tempdir().unwrap());
    let mut line = Line::at(&folder.path().join("ttyUSB0"));
    let _program = Program::start_in(folder.clone(), &charger_on("\"serial:{dir}/ttyUSB0\""), &[]);
    let mut seed = 7_u32;
    let mut dice = |sides: u32| {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 8) % sides
    };
    for poll in 0..10_000_u32 {
        // Another master's question to unit 9 and that slave's answer, then a question to ours right behind it.
        let quantity = 1 + dice(125) as u8;
        let function = 3 + dice(2) as u8;
        let mut traffic = framed(&[9, function, 0, dice(256) as u8, 0, quantity]);
        let mut reply = vec![9, function, quantity * 2];
        reply.extend((0..quantity * 2).map(|_| dice(256) as u8));
        match dice(4) {
            0 => traffic.extend(framed(&[9, function | 0x80, 2])),
            1 => traffic.extend(framed(&[9, 6, 0, 6, 0, 240]).repeat(2)),
            2 if quantity < 125 => traffic.extend(framed(&reply)),
            _ => traffic.extend(framed(&[9, 16, 0, 1, 0, 2])),
        }
        traffic.extend(framed(&ASK));
        let cut = 1 + dice(traffic.len() as u32 - 1) as usize;
        line.send(&traffic[..cut]);
        line.send(&traffic[cut..]);
        let got = line.receive(9, PATIENCE);
        assert_eq!(got, framed(&ANSWER), "poll {poll}");
    }
    line.expect_silence();
}

#[test]
fn bus_17_wire_timing_takes_as_long_as_the_line() {
    for baud in [2400, 9600, 19_200, 38_400, 115_200] {
        let config = format!(
            "[[bus]]\nname = \"line1\"\nport = \"pty:{{dir}}/line1\"\nbaud = {baud}\ntiming = \"wire\"\n\
             [[bus.device]]\nname = \"astro\"\nmodel = \"kael-astro-01\"\nunit = 1\n"
        );
        let program = Program::start(&config);
        let mut client = open(&program.line());
        // The clock's seven registers: 8 characters to ask, 19 to answer, and a silence of 3.5 between them; 11 bits each
        // with two stop bits.
        let request = framed(&[1, 3, 0, 0x10, 0, 7]);
        let line_time = Duration::from_secs_f64(30.5 * 11.0 / f64::from(baud));
        let mut fastest = Duration::MAX;
        for _ in 0..15 {
            let start = Instant::now();
            client.send(&request);
            assert_eq!(client.receive(19, PATIENCE).len(), 19);
            fastest = fastest.min(start.elapsed());
        }
        // The fastest of some is what the program does; the slower ones are what a busy machine adds.
        let allowed = line_time.mul_f64(1.1) + Duration::from_millis(1);
        assert!(line_time.mul_f64(0.9) <= fastest && fastest <= allowed, "{baud}: {fastest:?}, not {line_time:?}");
    }
}

#[test]
fn bus_17_fast_timing_waits_for_nothing() {
    let program = Program::start(&charger_on("\"pty:{dir}/line1\""));
    let mut client = open(&program.line());
    let mut fastest = Duration::MAX;
    for _ in 0..50 {
        let start = Instant::now();
        client.expect_answer();
        fastest = fastest.min(start.elapsed());
    }
    // 3.5 characters are 4 ms at 9600 baud.
    assert!(fastest < Duration::from_millis(1), "{fastest:?}");
}

//! `--trace`: every frame in hex and in words, on stderr.

use std::fmt::Write;
use std::io;

use super::task::Watcher;
use crate::bus::{Bus, Exchange, Form, Output};
use crate::faults::Hit;
use crate::station::Outcome;
use crate::wire::{Request, append_crc, function, function_name};

/// Prints what a bus hears and says. A reader of stderr that has gone is no reason to end.
pub fn watcher() -> Watcher {
    Box::new(|bus, output| {
        if let Output::Exchange(exchange) = output {
            let _ = io::Write::write_all(&mut io::stderr().lock(), text(bus, exchange).as_bytes());
        }
    })
}

/// The lines of an exchange: `>` is what came in, `<` what went out.
fn text(bus: &Bus, exchange: &Exchange) -> String {
    let station = exchange.station.map(|index| bus.stations()[index].name());
    let mut text = String::new();
    let mut line = |mark: char, bytes: &str, words: &str| {
        let at = exchange.at.civil.format("%Y-%m-%d %H:%M:%S%.3f");
        let _ = writeln!(text, "{} {at} {mark} {bytes}  {words}", bus.name());
    };
    let asked = match exchange.form {
        Form::Damaged => hex(&exchange.request),
        form => framed(form, &exchange.request),
    };
    line('>', &asked, &request_words(exchange, station));
    let (bytes, mut words) = match &exchange.outcome {
        Outcome::Silence(reason) => ("nothing".into(), reason.to_string()),
        Outcome::Reply => {
            let words = format!("{}, after {} us", reply_words(&exchange.reply), exchange.reply_us);
            (framed(exchange.form, &exchange.reply), words)
        }
        Outcome::Exception(refusal) => {
            let words = format!("exception {}: {refusal}, after {} us", refusal.exception, exchange.reply_us);
            (framed(exchange.form, &exchange.reply), words)
        }
    };
    for Hit { id, kind } in &exchange.faults {
        let _ = write!(words, ", fault {id} ({kind})");
    }
    if let Some(sent) = &exchange.sent {
        let _ = write!(words, ", sent as {}", hex(sent));
    }
    line('<', &bytes, &words);
    text
}

/// Unit, function and data as they are on the wire: with their CRC, or behind the header of Modbus TCP.
fn framed(form: Form, bytes: &[u8]) -> String {
    match form {
        Form::Tcp { transaction } => {
            let header = [transaction, 0, bytes.len() as u16].map(u16::to_be_bytes);
            hex(&[header.as_flattened(), bytes].concat())
        }
        Form::Rtu | Form::Damaged => {
            let mut frame = bytes.to_vec();
            append_crc(&mut frame);
            hex(&frame)
        }
    }
}

fn hex(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(bytes.len() * 3);
    for (index, byte) in bytes.iter().enumerate() {
        let gap = if index == 0 { "" } else { " " };
        let _ = write!(text, "{gap}{byte:02X}");
    }
    text
}

fn request_words(exchange: &Exchange, station: Option<&str>) -> String {
    if exchange.form == Form::Damaged {
        return "no frame".into();
    }
    let unit = match (exchange.unit, station) {
        (0, _) => "broadcast".into(),
        (unit, Some(name)) => format!("unit {unit} ({name})"),
        (unit, None) => format!("unit {unit}"),
    };
    let pdu = exchange.request.get(1..).unwrap_or(&[]);
    let Some(request) = Request::parse(pdu) else { return format!("{unit}: not a request") };
    let name = function_name(request.function());
    match request {
        Request::Read { start, quantity, .. } => format!("{unit}: {name} {start}, {quantity} of them"),
        Request::WriteSingle { addr, value, .. } => format!("{unit}: {name} {addr}: {value}"),
        Request::WriteMultiple { start, quantity, data, .. } => {
            let values = if request.function() == function::WRITE_MULTIPLE_REGISTERS {
                words(data)
            } else {
                bits(data, usize::from(quantity))
            };
            format!("{unit}: {name} {start}, {quantity} of them: {values}")
        }
        Request::Other { function } => format!("{unit}: function {function:02}"),
    }
}

fn reply_words(reply: &[u8]) -> String {
    let (code, data) = (reply.get(1).copied().unwrap_or(0), reply.get(3..).unwrap_or(&[]));
    match code {
        function::READ_HOLDING_REGISTERS | function::READ_INPUT_REGISTERS => words(data),
        function::READ_COILS | function::READ_DISCRETE_INPUTS => bits(data, data.len() * 8),
        _ => "done".into(),
    }
}

fn words(data: &[u8]) -> String {
    let words = data.chunks_exact(2).map(|word| u16::from_be_bytes([word[0], word[1]]).to_string());
    words.collect::<Vec<String>>().join(" ")
}

/// Bits in the order of their addresses.
fn bits(data: &[u8], quantity: usize) -> String {
    let bits = data.iter().flat_map(|byte| (0..8).map(move |bit| byte >> bit & 1));
    bits.take(quantity).map(|bit| char::from(b'0' + bit)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::{LineCheck, Settings, Timing};
    use crate::device::Refusal;
    use crate::line::{Line, Parity};
    use crate::time::{Instant, SimClock, civil};
    use crate::wire::Exception;

    fn traced(form: Form, request: &[u8], reply: &[u8], outcome: Outcome) -> String {
        let line = Line { baud: 9600, parity: Parity::None, stop_bits: 2 };
        let settings = Settings { line, timing: Timing::Fast, line_check: LineCheck::Off, slack_ms: 20 };
        let clock = SimClock::new(civil(2014, 10, 27, 14, 22, 8), 1.0);
        let bus = Bus::new("line1", settings, clock, Vec::new());
        let (at, unit) = (bus.moment(Instant(250_000)), request[0]);
        let (request, reply) = (request.into(), reply.into());
        text(
            &bus,
            &Exchange {
                at,
                reply_us: 120,
                unit,
                station: None,
                form,
                request,
                reply,
                outcome,
                faults: Vec::new(),
                sent: None,
            },
        )
    }

    #[test]
    fn frames_are_shown_as_they_are_on_the_wire() {
        // 01 03 00 00 00 0A C5 CD is the example of many a Modbus primer.
        let text = traced(Form::Rtu, &[1, 3, 0, 0, 0, 10], &[1, 3, 2, 0, 14], Outcome::Reply);
        let lines: Vec<&str> = text.lines().collect();
        let asked =
            "line1 2014-10-27 14:22:08.250 > 01 03 00 00 00 0A C5 CD  unit 1: read holding registers 0, 10 of them";
        assert_eq!(lines[0], asked);
        assert!(lines[1].ends_with("  14, after 120 us"), "{}", lines[1]);

        let text =
            traced(Form::Tcp { transaction: 258 }, &[1, 5, 0, 2, 0xFF, 0], &[1, 5, 0, 2, 0xFF, 0], Outcome::Reply);
        assert!(text.contains("> 01 02 00 00 00 06 01 05 00 02 FF 00  unit 1: write single coil 2: 65280"), "{text}");
    }

    #[test]
    fn refusals_and_silence_say_why() {
        let refusal = Refusal::new(Exception::IllegalDataAddress, "no such register", "BUS-11");
        let text = traced(Form::Rtu, &[1, 3, 0, 0x10, 0, 7], &[1, 0x83, 2], Outcome::Exception(refusal));
        // The CRC of 01 83 02 is C0 F1 in every Modbus primer.
        assert!(
            text.contains("< 01 83 02 C0 F1  exception 02 illegal data address: no such register (BUS-11)"),
            "{text}"
        );
        let text = traced(Form::Damaged, &[0xFF, 0], &[], Outcome::Silence("the CRC is wrong"));
        assert!(text.contains("> FF 00  no frame\n") && text.ends_with("< nothing  the CRC is wrong\n"), "{text}");
    }
}

//! What simulated time costs: CPU seconds of a simulated span of one device, without a bus or a client.

use std::sync::Arc;
use std::time::Instant as RealTime;

use standin::bus::{Bus, DoorKind, LineCheck, Output, Settings, Timing};
use standin::devices;
use standin::image::Layout;
use standin::line::{Address, Line, Parity};
use standin::options::Options;
use standin::station::{Setup, Station};
use standin::time::{Instant, SimClock, civil};
use standin::wire::append_crc;

fn bus(model: &str, inputs: &[(&str, f64)], registers: &[(String, i64)]) -> Bus {
    let kind = devices::kind(model).expect("a model of this program");
    let line = Line { baud: 9600, parity: Parity::None, stop_bits: 2 };
    let inputs = inputs.iter().map(|(name, value)| (kind.input(name).expect("an input"), *value));
    let setup = Setup {
        name: model.into(),
        kind,
        address: Address { unit: 1, line },
        options: Options::defaults(kind),
        inputs: inputs.collect(),
        registers: registers.to_vec(),
    };
    let clock = SimClock::new(civil(2014, 1, 1, 0, 0, 0), 1.0);
    let station = Station::new(setup, Arc::new(Layout::new(kind.map)), None, &clock).expect("the start values hold");
    let settings = Settings { line, timing: Timing::Fast, line_check: LineCheck::Off, slack_ms: 20 };
    Bus::new("bench", settings, clock, vec![station])
}

fn days(name: &str, bus: &mut Bus, now: Instant, count: u32) {
    let started = RealTime::now();
    for _ in 0..count * 24 {
        bus.advance_clock(now, 3_600_000_000);
    }
    println!("{name}: {:.3} s", started.elapsed().as_secs_f64());
}

/// Fills an Astro with 100 programs through its handshake, all relays, times and days mixed.
fn fill(bus: &mut Bus) -> Instant {
    let door = bus.open_door(Instant(0), DoorKind::Virtual);
    let mut now = Instant(0);
    let ask = |bus: &mut Bus, now: Instant, frame: &[u8]| {
        let mut frame = frame.to_vec();
        append_crc(&mut frame);
        bus.receive(now, door, &frame);
        while let Some(output) = bus.poll(now) {
            if let Output::Transmit { bytes, .. } = output {
                assert!(bytes[1] & 0x80 == 0, "refused: {bytes:02X?}");
            }
        }
    };
    for number in 4..100_u8 {
        let (settings, hour, minute) = (number % 16, number % 24, number % 60);
        ask(bus, now, &[1, 16, 0, 0x87, 0, 6, 12, 0, settings, 0, hour, 0, minute, 0, 0, 0, number, 0, 0x7F]);
        ask(bus, now, &[1, 16, 0, 0x84, 0, 2, 4, 0, 1, 0, 4]);
        now = now.plus_ms(60);
        bus.live_to(now);
    }
    now
}

fn main() {
    let mut astro = bus("kael-astro-03", &[], &[]);
    let now = fill(&mut astro);
    days("a year of an Astro with 100 programs", &mut astro, now, 365);

    let steps = (1..=24).flat_map(|n| [(format!("step_{n}_status"), 0), (format!("step_{n}_power_whole"), 1 + n % 5)]);
    let mut pfc = bus("logiccon-pfc24s-tcr", &[("load_reactive_a", 30.0)], &steps.collect::<Vec<_>>());
    days("a day of a PFC with 24 active steps", &mut pfc, Instant(0), 1);

    let mut trc = bus("logiccon-trc", &[], &[]);
    days("a day of a TRC", &mut trc, Instant(0), 1);
    let mut volcano = bus("hmi-volcano-ec", &[], &[("zone_mode".into(), 1)]);
    days("a day of a Volcano", &mut volcano, Instant(0), 1);
}

//! What is refused in a device: unit, line, inputs, options, start values.

use std::sync::Arc;

use standin::config::{Overrides, Start};
use standin::image::Layout;
use standin::station::Station;
use standin::time::civil;

use crate::{accepted, bus, charger, heater, parse, parse_with, refused};

#[test]
fn a_device_has_name_model_and_unit() {
    refused(
        &bus("port = \"pty:/p\"\n[[bus.device]]\n"),
        &[
            "t:4:1: [[bus.device]] needs model, for example model = \"kael-astro-01\"",
            "t:4:1: [[bus.device]] needs name, for example name = \"yard\"",
            "t:4:1: [[bus.device]] needs unit, for example unit = 1",
        ],
    );
    refused(
        &heater("inputs = 3\noptions = []\nregisters = \"x\""),
        &[
            "t:8:10: inputs takes a table, such as inputs = { … }, not 3",
            "t:9:11: options takes a table, such as options = { … }, not a list",
            "t:10:13: registers takes a table, such as registers = { … }, not \"x\"",
        ],
    );
}

#[test]
fn a_unit_lies_in_the_devices_own_range() {
    // VOL-1 says 1 to 247, TRC-6 says 1 to 255.
    refused(
        &heater("").replace("unit = 4", "unit = 248"),
        &["t:7:8: unit takes a whole number, 1 to 247 for hmi-volcano-ec, not 248"],
    );
    let config = accepted(&charger("").replace("unit = 4", "unit = 248"));
    let warning = "t:7:8: unit 248 is reserved by Modbus, whose units end at 247: many masters refuse it";
    assert_eq!(config.warnings, [warning]);
}

#[test]
fn bus_14_a_line_setting_that_a_device_does_not_offer_is_refused() {
    let with = |lines: &str| charger("").replace("port = \"pty:/tmp/p\"", &format!("port = \"pty:/tmp/p\"\n{lines}"));
    // The TRC's manual: 4800, 7200, 9600, 14400, 19200, 38400 baud, no parity, 1 or 2 stop bits.
    let baud = "charger (logiccon-trc) does not offer baud 2400 (it offers 4800, 7200, 9600, 14400, 19200, 38400)";
    let format =
        "charger (logiccon-trc) does not offer parity even with 1 stop bits (it offers none with 1, none with 2)";
    let lines = "baud = 2400\nparity = \"even\"\nstop_bits = 1";
    refused(&with(lines), &[&format!("t:4:8: {baud}"), &format!("t:5:10: {format}")]);
    let config = accepted(&with(&format!("{lines}\nline_check = \"off\"")));
    let shows = "its register shows the factory value";
    assert_eq!(config.warnings, [format!("t:4:8: {baud}; {shows}"), format!("t:5:10: {format}; {shows}")]);
}

#[test]
fn bus_21_inputs_are_known_and_within_their_range() {
    refused(
        &charger("inputs = { ac_voltag = 1, battery_connected = \"yes\", battery_charge = 1.5, temperature = nan }"),
        &[
            "t:8:12: logiccon-trc has no input \"ac_voltag\"; did you mean ac_voltage?",
            "t:8:47: battery_connected takes true or false, not \"yes\"",
            "t:8:71: battery_charge takes 0 to 1, not 1.5",
            "t:8:76: logiccon-trc has no input \"temperature\"; did you mean ambient_temperature?",
        ],
    );
}

#[test]
fn bus_21_inputs_are_the_world_that_a_device_measures() {
    let config = accepted(&charger("inputs = { ac_voltage = 241, load_current = 3.5 }"));
    let setup = config.buses[0].devices[0].clone();
    let layout = Arc::new(Layout::new(setup.kind.map));
    let station = Station::new(setup, layout, None, &config.clock(civil(2024, 1, 1, 0, 0, 0))).unwrap();
    let shown = |name: &str| station.raw(station.layout().named(name).unwrap());
    // TRC-1: the mains in volts, the load's current in tenths of an ampere.
    assert_eq!((shown("ac_voltage"), shown("output_current")), (241, 35));
}

#[test]
fn options_are_known_and_nested_tables_make_dotted_names() {
    refused(
        &charger("options = { boot_ms = 5, response_delay_ms = 60001, crc_error_reply = 1, range_check = [] }"),
        &[
            "t:8:13: logiccon-trc has no option \"boot_ms\"",
            "t:8:46: response_delay_ms takes a whole number, 0 to 60000, not 60001",
            "t:8:71: crc_error_reply takes \"exception\" or \"silent\", not 1",
            "t:8:88: range_check takes \"reject\" or \"accept\", not a list",
        ],
    );
    let compensator = |lines: &str| heater(lines).replace("hmi-volcano-ec", "logiccon-pfc24s-tcr");
    for lines in [
        "options = { decimal_digits = { note2 = 1, note4 = 2 } }",
        "options.decimal_digits.note2 = 1\noptions.decimal_digits.note4 = 2",
    ] {
        let config = accepted(&compensator(lines));
        let options = &config.buses[0].devices[0].options;
        let digits = ["note2", "note3", "note4"].map(|note| options.integer(&format!("decimal_digits.{note}")));
        assert_eq!(digits, [1, 3, 2]);
    }
    let error = parse(&compensator("options = { decimal_digits = { note5 = 1 } }")).unwrap_err();
    assert!(
        error.starts_with(
            "t:8:32: logiccon-pfc24s-tcr has no option \"decimal_digits.note5\"; did you mean decimal_digits.note"
        ),
        "{error}"
    );
}

#[test]
fn start_values_are_judged_one_by_one() {
    refused(
        &heater(
            "[bus.device.registers]\nzone_program = 2\nzone_temperature_actual = 5\nrtc_hour = 1.5\nntc_1_correct = 64736\nlock_keypad = 2\nzone_mod = 1\nbogus = 1",
        ),
        &[
            "t:9:16: zone_program takes 0 to 1, not 2 (VOL-44)",
            "t:10:1: zone_temperature_actual is only read: it has no start value (VOL-40)",
            "t:11:12: rtc_hour takes 0 to 23, not 1.5 (VOL-1)",
            "t:12:17: ntc_1_correct takes -1440 to 1440, not 64736 (VOL-40)",
            "t:13:15: lock_keypad takes 0 to 1, not 2 (VOL-1)",
            "t:14:1: hmi-volcano-ec has no register \"zone_mod\"; did you mean zone_mode? `standin registers hmi-volcano-ec` lists them",
            "t:15:1: hmi-volcano-ec has no register \"bogus\"; `standin registers hmi-volcano-ec` lists them",
        ],
    );
}

#[test]
fn bus_22_start_values_are_judged_together_by_the_devices_rules() {
    // VOL-15: each period's start is below its stop; the stop alone would be too low, the pair is not.
    let stop_alone = "zone_schedule_mon_fri_work_1_stop = 300";
    let why = "heater refuses these start values: each period of the schedule starts before it stops (VOL-15)";
    refused(&heater(&format!("registers = {{ {stop_alone} }}")), &[&format!("t:8:1: {why}")]);
    accepted(&heater(&format!("registers = {{ {stop_alone}, zone_schedule_mon_fri_work_1_start = 240 }}")));
    // VOL-2 binds messages on the bus, not start values.
    accepted(&heater("registers = { ntc_1_correct = 100, ntc_period = 5 }"));
}

#[test]
fn start_values_are_judged_at_the_start_of_the_clock() {
    // VOL-20: the day's limit follows the month; 30 fits in October and not in February.
    let october = format!("clock.start = 2014-10-01T00:00:00\n{}", heater("registers = { rtc_day = 30 }"));
    accepted(&october);
    let february = october.replace("2014-10", "2014-02");
    refused(&february, &["t:9:1: heater refuses these start values: the month has no such day (VOL-20)"]);
    let start = Some(Start::At(civil(2014, 10, 1, 0, 0, 0)));
    assert!(parse_with(&february, &Overrides { start, ..Overrides::default() }).is_ok());
}

#[test]
fn unit_and_line_registers_say_where_they_are_set() {
    refused(
        &heater("registers = { slave_addr = 3, baudrate = 960, parity_mode = 110 }"),
        &[
            "t:8:15: slave_addr is set by the device's key `unit`, not under registers",
            "t:8:31: baudrate is set by the bus' key `baud`, not under registers",
            "t:8:47: parity_mode is set by the bus' keys `parity` and `stop_bits`, not under registers",
        ],
    );
}

#[test]
fn a_bus_without_devices_is_a_warning() {
    let config = accepted(&bus("port = \"pty:/p\""));
    assert_eq!(config.warnings, ["t:1:1: this bus has no [[bus.device]]: nobody answers on it"]);
}

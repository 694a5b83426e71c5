//! Physics of the DC motor, compared with closed forms and with numbers of the data sheet that are not parameters.

use scenario::plant::DcMotor as Config;

use super::*;
use crate::plant::CURRENT;

/// `g`, m/s².
const GRAVITY: f64 = 9.806_65;

/// Returns the mass that the spring swings: load, rotor and gearbox at the rack.
fn mass(config: &Config) -> f64 {
    let transmission = config.gear_ratio / config.pinion_radius_metres;
    let inertia =
        config.rotor_inertia_kilogram_square_metres + config.gear_inertia_kilogram_square_metres;
    config.load_kilograms + inertia * transmission * transmission
}

fn force_per_ampere(config: &Config) -> f64 {
    config.torque_constant_newton_metres_per_ampere * config.gear_ratio
        / config.pinion_radius_metres
}

fn coulomb_newtons(config: &Config) -> f64 {
    let motor = config.coulomb_friction_newton_metres * config.gear_ratio;
    (motor + config.gear_friction_newton_metres) / config.pinion_radius_metres
}

fn damping(config: &Config) -> f64 {
    let transmission = config.gear_ratio / config.pinion_radius_metres;
    config.viscous_friction_newton_metre_seconds * transmission * transmission
}

/// Returns the shipped motor without one or both frictions.
fn config(has_coulomb: bool, viscous_factor: f64) -> Config {
    let mut config = Config::default();
    config.viscous_friction_newton_metre_seconds *= viscous_factor;
    if !has_coulomb {
        config.coulomb_friction_newton_metres = 0.0;
        config.gear_friction_newton_metres = 0.0;
    }
    config
}

/// Returns a motor that is lifted to a height and released there.
fn let_go_at(config: &Config, position_metres: f64) -> DcMotor {
    let mut motor = DcMotor::with(config);
    motor.motion.position_metres = position_metres;
    motor
}

fn current(current_amperes: f64) -> Inputs {
    Inputs {
        current_amperes,
        ..Inputs::default()
    }
}

/// Returns the current that holds a height without friction.
fn holding_amperes(config: &Config, position_metres: f64) -> f64 {
    let force = config.spring_newtons_per_metre * position_metres + config.load_kilograms * GRAVITY;
    force / force_per_ampere(config)
}

/// Returns the times at which the velocity changes its sign, and the heights there.
fn turns(motor: &mut DcMotor, inputs: &Inputs, seconds: f64) -> Vec<(f64, f64)> {
    let step = 1e-4;
    let mut turns = Vec::new();
    let mut before = motor.motion.velocity_metres_per_second;
    let mut time = 0.0;
    while time < seconds {
        motor.advance(step, inputs);
        time += step;
        let now = motor.motion.velocity_metres_per_second;
        if before != 0.0 && now * before <= 0.0 {
            turns.push((time, motor.motion.position_metres));
        }
        before = now;
    }
    turns
}

#[test]
fn the_parameters_agree_with_what_the_data_sheet_says_besides() {
    let motor = Config::default();
    let torque_constant = motor.torque_constant_newton_metres_per_ampere;
    // No-load current 26.3 mA at 4850 rpm: all of its torque is friction.
    let no_load = 4850.0 * std::f64::consts::TAU / 60.0;
    let friction = motor.coulomb_friction_newton_metres
        + motor.viscous_friction_newton_metre_seconds * no_load;
    assert!((friction / torque_constant - 26.3e-3).abs() < 0.1e-3);
    // Mechanical time constant 4.25 ms = R J / kM².
    let mechanical = motor.winding_resistance_ohms * motor.rotor_inertia_kilogram_square_metres
        / (torque_constant * torque_constant);
    assert!((mechanical - 4.25e-3).abs() < 0.05e-3, "{mechanical}");
    // No-load speed 4850 rpm at 12 V, with the speed constant 1 / kM.
    let speed = (12.0 - motor.winding_resistance_ohms * 26.3e-3) / torque_constant;
    assert!((speed / no_load - 1.0).abs() < 0.01, "{speed} {no_load}");
}

/// The nominal current of 1.24 A is the one that brings the winding to its largest temperature, 100 °C, in air
/// of 25 °C.
#[test]
fn the_nominal_current_heats_the_winding_to_its_largest_temperature() {
    let mut motor = DcMotor::with(&Config::default());
    motor.advance(10.0 * 612.0, &current(1.24));
    assert!(
        (motor.heat.winding_celsius - 100.0).abs() < 1.5,
        "{}",
        motor.heat.winding_celsius
    );
}

/// `T = Tamb + (Rth1 / f + Rth2) P` with `P = R25 (1 + α (T − 25)) i²`, solved for `T`.
#[test]
fn the_temperatures_settle_where_heat_in_is_heat_out() {
    let config = Config::default();
    for (amperes, fan) in [(0.5, 1.0), (1.0, 1.0), (1.0, 5.0)] {
        let inputs = Inputs {
            convection_factor: fan,
            ..current(amperes)
        };
        let mut motor = DcMotor::with(&config);
        motor.advance(20.0 * 612.0, &inputs);
        let to_air = config.housing_to_ambient_kelvins_per_watt / fan;
        let resistance = to_air + config.winding_to_housing_kelvins_per_watt;
        let at_reference = config.winding_resistance_ohms * amperes * amperes * resistance;
        let rise = at_reference / (1.0 - 0.003_93 * at_reference);
        assert!(
            (motor.heat.winding_celsius - 25.0 - rise).abs() < 0.01,
            "{amperes} A, fan {fan}"
        );
        let housing = rise * to_air / resistance;
        assert!((motor.heat.housing_celsius - 25.0 - housing).abs() < 0.01);
    }
}

#[test]
fn without_friction_the_load_swings_at_its_natural_frequency_for_ever() {
    let config = config(false, 0.0);
    let half = std::f64::consts::PI * (mass(&config) / config.spring_newtons_per_metre).sqrt();
    let mut motor = let_go_at(&config, 0.035);
    let turns = turns(
        &mut motor,
        &current(holding_amperes(&config, 0.02)),
        20.5 * half,
    );
    assert_eq!(turns.len(), 20);
    for (number, (time, height)) in (1_u32..).zip(&turns) {
        assert!(
            (time - f64::from(number) * half).abs() < 2e-4,
            "{number}: {time}"
        );
        let expected = if number % 2 == 0 { 0.035 } else { 0.005 };
        assert!((height - expected).abs() < 1e-6, "{number}: {height}");
    }
}

/// Amplitudes fall by `exp(−π ζ / √(1 − ζ²))` each half swing.
#[test]
fn viscous_friction_alone_takes_the_same_share_of_every_swing() {
    let config = config(false, 5.0);
    let (mass, stiffness) = (mass(&config), config.spring_newtons_per_metre);
    let ratio = damping(&config) / (2.0 * (mass * stiffness).sqrt());
    let share = libm::exp(-std::f64::consts::PI * ratio / (1.0 - ratio * ratio).sqrt());
    let mut motor = let_go_at(&config, 0.05);
    let turns = turns(&mut motor, &current(holding_amperes(&config, 0.03)), 3.0);
    let mut amplitude = 0.02;
    for (time, height) in &turns {
        amplitude *= share;
        assert!(
            ((height - 0.03).abs() / amplitude - 1.0).abs() < 1e-3,
            "{time}: {height}"
        );
    }
    assert!(turns.len() >= 8);
}

/// Amplitudes fall by `2 F / k` each half swing, until the spring no longer overcomes the friction.
#[test]
fn coulomb_friction_alone_takes_the_same_height_of_every_swing() {
    let config = Config {
        gear_friction_newton_metres: 0.0,
        ..config(true, 0.0)
    };
    let loss = 2.0 * coulomb_newtons(&config) / config.spring_newtons_per_metre;
    let mut motor = let_go_at(&config, 0.05);
    let inputs = current(holding_amperes(&config, 0.03));
    let turns = turns(&mut motor, &inputs, 6.0);
    let mut amplitude = 0.02;
    for (time, height) in &turns {
        amplitude -= loss;
        assert!(
            ((height - 0.03).abs() - amplitude).abs() < 2e-6,
            "{time}: {height}"
        );
    }
    let expected = ((0.02 / loss) - 0.5).ceil();
    assert!((turns.len() as f64 - expected).abs() < 0.5, "{turns:?}");
    let rest = motor.motion.position_metres;
    motor.advance(1.0, &inputs);
    assert_eq!(
        (
            motor.motion.position_metres,
            motor.motion.velocity_metres_per_second
        ),
        (rest, 0.0)
    );
}

/// A slow current up and down: the load follows, less the friction on its way up, more of it on its way down.
#[test]
fn a_slow_ramp_draws_the_hysteresis_of_the_friction() {
    let config = Config::default();
    let mut motor = DcMotor::with(&config);
    let friction = coulomb_newtons(&config) / config.spring_newtons_per_metre;
    let mut heights = Vec::new();
    for millisecond in 0..240_000_u32 {
        let seconds = f64::from(millisecond) * 1e-3;
        let amperes = 0.6 * (1.0 - (seconds / 120.0 - 1.0).abs());
        motor.advance(1e-3, &current(amperes));
        if millisecond == 60_000 || millisecond == 180_000 {
            heights.push(motor.motion.position_metres);
        }
    }
    let weight = config.load_kilograms * GRAVITY;
    let middle = (force_per_ampere(&config) * 0.3 - weight) / config.spring_newtons_per_metre;
    assert!(
        (heights[0] - (middle - friction)).abs() < 0.1 * friction,
        "{heights:?} {middle}"
    );
    assert!(
        (heights[1] - (middle + friction)).abs() < 0.1 * friction,
        "{heights:?} {middle}"
    );
}

/// `K / √((k − M ω²)² + (B ω)²)`, below, at and above the natural frequency.
#[test]
fn a_sine_of_current_is_answered_as_the_linear_equation_says() {
    let config = config(false, 20.0);
    let (mass, stiffness) = (mass(&config), config.spring_newtons_per_metre);
    let natural = (stiffness / mass).sqrt();
    for factor in [0.3, 1.0, 2.0] {
        let frequency = factor * natural;
        let mut motor = let_go_at(&config, 0.03);
        let bias = holding_amperes(&config, 0.03);
        let (mut highest, mut lowest) = (f64::MIN, f64::MAX);
        for step in 0..120_000_u32 {
            let seconds = (f64::from(step) + 0.5) * 2.5e-4;
            let amperes = bias + 0.02 * libm::sin(frequency * seconds);
            motor.advance(2.5e-4, &current(amperes));
            if step > 100_000 {
                highest = motor.motion.position_metres.max(highest);
                lowest = motor.motion.position_metres.min(lowest);
            }
        }
        let reactance = stiffness - mass * frequency * frequency;
        let resistance = damping(&config) * frequency;
        let expected = 0.02 * force_per_ampere(&config) / reactance.hypot(resistance);
        let found = 0.5 * (highest - lowest);
        assert!(
            (found / expected - 1.0).abs() < 2e-3,
            "{factor}: {found} {expected}"
        );
    }
}

#[test]
fn what_the_motor_puts_in_is_stored_or_rubbed_away() {
    // The stops take energy, too: the upper one is out of reach.
    let config = Config {
        travel_metres: 1.0,
        ..Config::default()
    };
    let mut motor = let_go_at(&config, 0.02);
    let step = 1e-4;
    let energy = |motor: &DcMotor| {
        let (height, speed) = (
            motor.motion.position_metres,
            motor.motion.velocity_metres_per_second,
        );
        0.5 * mass(&config) * speed * speed
            + 0.5 * config.spring_newtons_per_metre * height * height
            + config.load_kilograms * GRAVITY * height
    };
    let before = energy(&motor);
    let (mut work, mut coulomb, mut viscous) = (0.0, 0.0, 0.0);
    for index in 0..50_000_u32 {
        let seconds = f64::from(index) * step;
        let amperes = 0.45 + 0.15 * libm::sin(3.0 * seconds) + 0.05 * libm::sin(7.0 * seconds);
        let (height, speed) = (
            motor.motion.position_metres,
            motor.motion.velocity_metres_per_second,
        );
        motor.advance(step, &current(amperes));
        let way = motor.motion.position_metres - height;
        let mean = 0.5 * (speed + motor.motion.velocity_metres_per_second);
        work += force_per_ampere(&config) * amperes * way;
        coulomb += coulomb_newtons(&config) * way.abs();
        viscous += damping(&config) * mean * mean * step;
        assert!(
            motor.motion.position_metres > 0.0,
            "the stop takes energy too"
        );
    }
    let stored = energy(&motor) - before;
    let missing = work - stored - coulomb - viscous;
    assert!(coulomb > 0.2 && viscous > 0.01, "{coulomb} {viscous}");
    assert!(missing.abs() < 1e-3 * (coulomb + viscous), "{missing}");
}

#[test]
fn the_load_rests_on_its_stop_until_the_current_lifts_it() {
    let config = Config::default();
    let needed =
        (config.load_kilograms * GRAVITY + coulomb_newtons(&config)) / force_per_ampere(&config);
    let mut motor = DcMotor::with(&config);
    motor.advance(1.0, &current(-1.0));
    motor.advance(1.0, &current(0.99 * needed));
    assert_eq!(motor.motion.position_metres, 0.0);
    motor.advance(1.0, &current(1.01 * needed));
    assert!(motor.motion.position_metres > 0.0);
}

#[test]
fn a_jammed_pinion_stands_and_a_dropped_load_no_longer_pulls() {
    let config = config(false, 20.0);
    let mut motor = let_go_at(&config, 0.03);
    let text = "schema = 1\nrig = \"dc_motor\"\nname = \"t\"\nduration_seconds = 9.0\n[controller.open_loop]\n\
                [[fault.plant.jammed_pulley]]\nfrom_seconds = 1.0\nuntil_seconds = 2.0\n\
                [[fault.plant.dropped_load]]\nfrom_seconds = 2.0\n";
    let scenario = testing::part(text, "drive");
    motor.set_condition(CURRENT, &scenario.run.faults, 1.5);
    motor.advance(1.0, &current(1.0));
    assert_eq!(motor.motion.position_metres, 0.03);
    motor.set_condition(CURRENT, &scenario.run.faults, 2.5);
    motor.advance(60.0, &current(holding_amperes(&config, 0.03)));
    let higher = config.load_kilograms * GRAVITY / config.spring_newtons_per_metre;
    assert!((motor.motion.position_metres - 0.03 - higher).abs() < 1e-6);
}

#[test]
fn many_short_steps_come_to_the_same_as_one_long() {
    let inputs = current(0.5);
    let (mut once, mut often) = (
        DcMotor::with(&Config::default()),
        DcMotor::with(&Config::default()),
    );
    once.advance(2.0, &inputs);
    for _ in 0..6250 {
        often.advance(0.000_32, &inputs);
    }
    assert!((once.motion.position_metres - often.motion.position_metres).abs() < 1e-6);
    assert!((once.heat.winding_celsius - often.heat.winding_celsius).abs() < 1e-9);
}

#[test]
fn a_motor_that_is_too_fast_is_refused() {
    let config = Config {
        rotor_inertia_kilogram_square_metres: 1e-12,
        gear_inertia_kilogram_square_metres: 0.0,
        spring_newtons_per_metre: 1e6,
        ..Config::default()
    };
    let message = check(&config).unwrap_err().to_string();
    assert!(message.starts_with("motion changes at up to"), "{message}");
}

/// The largest current would hold the load far above the upper stop; there it rests until the motor lets it down.
#[test]
fn the_load_rests_on_the_upper_stop_and_leaves_it_downwards() {
    for travel_metres in [0.06, 0.0123] {
        let config = Config {
            travel_metres,
            ..Config::default()
        };
        let mut motor = DcMotor::with(&config);
        let mut highest: f64 = 0.0;
        for _ in 0..5_000 {
            motor.advance(1e-4, &current(1.0));
            highest = highest.max(motor.motion.position_metres);
        }
        assert_eq!([highest, motor.motion.position_metres], [travel_metres; 2]);
        assert_eq!(motor.motion.velocity_metres_per_second, 0.0);
        // Within the friction of the load's weight and the spring it stays where it is.
        let holding = holding_amperes(&config, travel_metres);
        motor.advance(0.1, &current(holding));
        assert_eq!(motor.motion.position_metres, travel_metres);
        motor.advance(0.1, &current(-1.0));
        assert!(motor.motion.position_metres < travel_metres);
    }
}

/// A motor that does not reach its upper stop moves as one without any.
#[test]
fn a_stop_out_of_reach_changes_nothing() {
    let motor_with = |travel_metres| {
        DcMotor::with(&Config {
            travel_metres,
            ..Config::default()
        })
    };
    let [mut near, mut far] = [0.06, 1_000.0].map(motor_with);
    let amperes = holding_amperes(&Config::default(), 0.03);
    for _ in 0..2_000 {
        near.advance(1e-3, &current(amperes));
        far.advance(1e-3, &current(amperes));
        assert_eq!(near.motion.position_metres, far.motion.position_metres);
    }
}

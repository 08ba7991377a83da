//! How is a robot driven by hand in a terminal? Keys in, twists out twenty times a second, each echoing the newest state seen
//! from the robot: when the link or this program freezes, the echo grows old and the robot stops by itself.
//!
//! Leaving by Ctrl-C, by a closed terminal or by a failure always leaves the robot stopped until `zenav resume`; Enter gives control
//! back to the mission before.

use std::io::{IsTerminal as _, Write as _};
use std::time::Duration;

use crossterm::event::{self, KeyCode, KeyEventKind, KeyModifiers};
use crossterm::terminal;
use tokio::sync::mpsc;
use tokio::time::Instant;
use zenav_protocol::bus::{Bus, Latest, Publisher};
use zenav_protocol::geometry::Twist2;
use zenav_protocol::messages::{EdgeState, InfoRequest, Mode, ResumeRequest, StopRequest, Teleop, exit_code};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use super::hand::{Hand, Wish, wish};
use super::hold::Held;
use super::holder;
use crate::connect::{self, RobotArgs, positive};
use crate::failure::{Failure, Outcome};

/// Twists a second.
const PERIOD: Duration = Duration::from_millis(50);
/// A state older than this is told: the robot drops what echoes it.
const OLD: Duration = Duration::from_millis(300);
/// Speeds for a robot that does not tell its own, m/s and rad/s.
const CAREFUL: Twist2 = Twist2 { v: 0.3, w: 1.0 };

const HELP: &str = "Space take control and stop   Enter give back   W A S D (Q E) drive   + - speed   R resume   Ctrl-C stop and leave";

/// Driving by hand.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Space takes control and stops, Enter gives it back, W A S D drive while held (Q E in curves), + and - set the speed, R lets a stopped robot go. Ctrl-C leaves the robot stopped: `zenav resume` lets it go."
)]
pub struct TeleopArgs {
    /// Which robot.
    #[command(flatten)]
    robot: RobotArgs,
    /// Greatest speed, m/s [default: what the robot can]
    #[arg(long, value_name = "M/S", value_parser = positive)]
    speed: Option<f64>,
    /// Greatest yaw rate, rad/s [default: what the robot can]
    #[arg(long, value_name = "RAD/S", value_parser = positive)]
    turn: Option<f64>,
}

/// Drives by hand until Ctrl-C.
///
/// # Errors
/// [`exit_code::USAGE`] without a terminal; what goes wrong on the way, after the robot was stopped.
pub fn teleop(args: &TeleopArgs) -> Outcome {
    if !std::io::stdin().is_terminal() {
        return Err(Failure::usage("teleop needs a terminal: its keys drive the robot"));
    }
    let patience = args.robot.link.patience();
    connect::on_robot(&args.robot, async |bus, robot| {
        let top = top_speeds(&bus, &robot, patience).await;
        let top = Twist2::new(args.speed.unwrap_or(top.v), args.turn.unwrap_or(top.w));
        let screen = RawTerminal::open()?;
        let mut session = Session::new(&bus, &robot, top)?;
        let driven = session.run(keys()).await;
        let stopped = session.leave(patience).await;
        drop(screen);
        match stopped {
            Ok(()) => eprintln!("{robot} is stopped; `zenav resume` lets it go"),
            Err(error) => {
                return Err(Failure::new(
                    error.code,
                    format!("{robot} did not confirm its stop: {error} (without commands it stops by itself)"),
                ));
            }
        }
        driven.map(|()| exit_code::OK)
    })
}

/// What the robot can, by its own word.
async fn top_speeds(bus: &Bus, robot: &str, within: Duration) -> Twist2 {
    match bus.ask(&topics::EDGE_INFO, &[robot], &InfoRequest {}, within).await {
        Ok(info) => info.model.map_or(CAREFUL, |model| {
            Twist2::new(model.drive.top_speed(), model.drive.top_yaw_rate())
        }),
        Err(error) => {
            tracing::warn!(%error, "the robot does not tell its limits; driving carefully");
            CAREFUL
        }
    }
}

/// The terminal without line editing, until dropped: also on the way out of a panic.
struct RawTerminal;

impl RawTerminal {
    fn open() -> Result<Self, Failure> {
        terminal::enable_raw_mode()?;
        Ok(Self)
    }
}

impl Drop for RawTerminal {
    fn drop(&mut self) {
        // Nothing can be done about a terminal that is gone.
        let _ = terminal::disable_raw_mode();
        eprintln!();
    }
}

/// Wishes as they are typed; ends when the terminal does.
fn keys() -> mpsc::UnboundedReceiver<Wish> {
    let (sender, receiver) = mpsc::unbounded_channel();
    std::thread::spawn(move || {
        while let Ok(event) = event::read() {
            let event::Event::Key(key) = event else { continue };
            if key.kind == KeyEventKind::Release {
                continue;
            }
            let control = key.modifiers.contains(KeyModifiers::CONTROL);
            let found = match key.code {
                KeyCode::Char(letter) => wish(letter, control),
                KeyCode::Enter => wish('\n', false),
                KeyCode::Up => wish('w', false),
                KeyCode::Down => wish('s', false),
                KeyCode::Left => wish('a', false),
                KeyCode::Right => wish('d', false),
                _ => None,
            };
            if found.is_some_and(|found| sender.send(found).is_err()) {
                return;
            }
        }
    });
    receiver
}

/// One sitting at the keys.
struct Session {
    bus: Bus,
    robot: String,
    holder: String,
    hand: Hand,
    states: Latest<EdgeState>,
    teleop: Publisher<Teleop>,
    held: Option<Held>,
    seen: Option<(Instant, EdgeState)>,
    note: String,
    start: Instant,
}

impl Session {
    fn new(bus: &Bus, robot: &str, top: Twist2) -> Result<Self, Failure> {
        Ok(Self {
            bus: bus.clone(),
            robot: robot.to_owned(),
            holder: holder(),
            hand: Hand::new(top),
            states: bus.latest(&topics::STATE, &[robot])?,
            teleop: bus.publisher(&topics::TELEOP, &[robot])?,
            held: None,
            seen: None,
            note: String::new(),
            start: Instant::now(),
        })
    }

    /// Until somebody wants to leave, by key, by signal, or because the terminal is gone.
    async fn run(&mut self, mut keys: mpsc::UnboundedReceiver<Wish>) -> Result<(), Failure> {
        eprint!("{HELP}\r\n");
        let mut pace = tokio::time::interval(PERIOD);
        let ended = ended();
        tokio::pin!(ended);
        loop {
            tokio::select! {
                biased;
                () = &mut ended => return Ok(()),
                key = keys.recv() => match key {
                    None | Some(Wish::Quit) => return Ok(()),
                    Some(wish) => self.act(wish).await,
                },
                _ = pace.tick() => {
                    if let Some(state) = self.states.take() {
                        self.seen = Some((Instant::now(), state));
                    }
                    self.drop_lost_lease();
                    self.drive();
                    self.draw();
                }
            }
        }
    }

    async fn act(&mut self, wish: Wish) {
        self.note.clear();
        match wish {
            Wish::Take => self.take().await,
            Wish::Give => {
                self.hand.rest();
                self.drive();
                if let Some(held) = self.held.take()
                    && let Err(error) = held.release().await
                {
                    self.note = error.to_string();
                }
            }
            Wish::Move { .. } if self.held.is_none() => self.note = "Space takes control first".to_owned(),
            Wish::Move { forward, left } => self.hand.press(self.start.elapsed(), forward, left),
            Wish::Faster => self.hand.scale(true),
            Wish::Slower => self.hand.scale(false),
            Wish::Resume => {
                let request = ResumeRequest {
                    by: Some(self.holder.clone()),
                };
                if let Err(error) = self
                    .bus
                    .ask(&topics::RESUME, &[&self.robot], &request, Duration::from_secs(1))
                    .await
                {
                    self.note = error.to_string();
                }
            }
            Wish::Quit => {}
        }
    }

    async fn take(&mut self) {
        self.hand.rest();
        self.drive();
        if self.held.is_some() {
            return;
        }
        match Held::acquire(&self.bus, &self.robot, &self.holder, Duration::from_secs(1)).await {
            Ok(held) => self.held = Some(held),
            Err(error) => self.note = error.to_string(),
        }
    }

    /// The robot's word counts: a lease of another epoch or holder is not ours any more.
    fn drop_lost_lease(&mut self) {
        let (Some(held), Some((_, state))) = (&self.held, &self.seen) else {
            return;
        };
        if state.lease.epoch > held.grant.epoch {
            self.note = format!(
                "control was lost to {}",
                state.lease.holder.as_deref().unwrap_or("nobody")
            );
            self.held = None;
            self.hand.rest();
        }
    }

    fn drive(&self) {
        if let (Some(held), Some((_, state))) = (&self.held, &self.seen) {
            self.teleop.put(&Teleop {
                epoch: held.grant.epoch,
                twist: self.hand.twist(self.start.elapsed()),
                echo: state.stamp,
            });
        }
    }

    fn draw(&self) {
        // A window of no size is one whose size is not known.
        let width = terminal::size()
            .ok()
            .filter(|(columns, _)| *columns > 0)
            .map_or(80, |(columns, _)| usize::from(columns));
        let line: String = self.status().chars().take(width.saturating_sub(1)).collect();
        // To the line's start, and the rest of the line cleared.
        eprint!("\r{line}\x1b[K");
        let _ = std::io::stderr().flush();
    }

    fn status(&self) -> String {
        let Some((at, state)) = &self.seen else {
            return format!("{}: nothing heard yet  {}", self.robot, self.note);
        };
        let command = match (&self.held, &state.lease.holder) {
            (Some(_), _) => "YOU".to_owned(),
            (None, Some(holder)) if state.lease.live => holder.clone(),
            _ => match (state.mode, state.wall_follower) {
                (Mode::WallFollow, Some(follower)) => format!("itself: {}", follower.name()),
                _ => "nobody".to_owned(),
            },
        };
        let age = at.elapsed();
        let link = if age > OLD {
            format!("silent for {:.1} s", age.as_secs_f64())
        } else {
            format!("{:?}", state.link)
        };
        let stopped = if state.mode == Mode::Stopped {
            " (R lets it go)"
        } else {
            ""
        };
        let limit = self.hand.limit();
        // What matters most comes first: a narrow terminal shows the beginning.
        format!(
            "{} | {command} | {:?}{stopped} | {} m/s {} rad/s (of {:.2} {:.2}) | guard {:?} | {link} | {:.0} % | {}",
            self.robot,
            state.mode,
            signed(state.velocity.v),
            signed(state.velocity.w),
            limit.v,
            limit.w,
            state.guard,
            100.0 * state.battery,
            self.note
        )
    }

    /// Leaves the robot stopped, whoever was in command.
    async fn leave(&mut self, within: Duration) -> Result<(), Failure> {
        if let Some(held) = &self.held {
            self.teleop.put(&Teleop {
                epoch: held.grant.epoch,
                twist: Twist2::ZERO,
                echo: self.seen.as_ref().map_or(Stamp::ZERO, |(_, state)| state.stamp),
            });
        }
        let request = StopRequest {
            by: Some(self.holder.clone()),
        };
        let stopped = self.bus.ask(&topics::STOP, &[&self.robot], &request, within).await;
        if let Some(held) = self.held.take() {
            // It ends by itself when nobody renews it.
            let _ = held.release().await;
        }
        if stopped?.stopped {
            Ok(())
        } else {
            Err(Failure::failed("it says that it is not stopped"))
        }
    }
}

/// With its sign, and without one for what rounds to zero.
fn signed(value: f64) -> String {
    let text = format!("{value:+.2}");
    if text == "-0.00" { "+0.00".to_owned() } else { text }
}

/// Waits for a signal to end: Ctrl-C from elsewhere, a closed terminal, or `kill`.
async fn ended() {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        let (Ok(mut hangup), Ok(mut terminate)) = (signal(SignalKind::hangup()), signal(SignalKind::terminate()))
        else {
            let _ = tokio::signal::ctrl_c().await;
            return;
        };
        tokio::select! {
            _ = tokio::signal::ctrl_c() => {}
            _ = hangup.recv() => {}
            _ = terminate.recv() => {}
        }
    }
    #[cfg(not(unix))]
    {
        let _ = tokio::signal::ctrl_c().await;
    }
}

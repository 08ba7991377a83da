//! Leadership. What does the mapping service do that leads, from its first beat until it ends or steps back?
//!
//! | file | subject |
//! |---|---|
//! | `beginning` | term, map, places and zones at the start; a takeover |
//! | `pulse` | the leader's beats, and whether it was suspended |
//! | `rivals` | whether another service leads, or may lead by now |
//! | `inbox` | all that a leader hears |
//! | `scans` | what is done with a scan |
//! | `publications` | what is published of the map, and when |
//! | `graph` | when SLAM's pose graph is published |
//! | `restating` | other publishers on the leader's keys |
//! | `body` | the robot's outline and message schema |
//! | `authority` | may this request change the map? |
//! | `requests` | answers; each change is carried out once |
//! | `encodings` | the map as JSON, CBOR, PNG, PGM or YAML |
//! | `stored_maps` | storing and loading of maps |
//! | `session` | SLAM's session on disk |

mod authority;
mod beginning;
mod body;
mod encodings;
mod graph;
mod inbox;
mod publications;
mod pulse;
mod requests;
mod restating;
mod rivals;
mod scans;
mod session;
mod stored_maps;

use std::time::{Duration, Instant};

use tokio::task::JoinSet;
use tokio::time::MissedTickBehavior;
use zenav_observability::trace::Context;
use zenav_protocol::bus::{AliveToken, Clock};
use zenav_protocol::messages::{Annotations, EdgeState, MapFrame, MapReply, MappingLeader};
use zenav_protocol::time::Stamp;

use super::annotations::AnnotationBook;
use super::follow::Followed;
use super::metrics::MappingMetrics;
use super::service::{MappingService, Turn};
use super::storage::Tenancy;
use super::{MappingConfig, MappingCore, MappingError, succession};

use authority::Authority;
use beginning::Beginning;
use body::{Body, FOREIGN, ask_body};
use graph::GraphPace;
use inbox::{Heard, Inbox, Waiting};
use publications::Outbox;
use pulse::Pulse;
use requests::FirstAnswers;
use rivals::{Company, Rivals};
use session::KeptSession;

/// Leads until shutdown, or until another service does. `followed`: what was known of the leader before.
///
/// # Errors
/// [`MappingError`], as for [`run`](super::run).
pub(super) async fn lead(part: &MappingService, mut followed: Followed) -> Result<Turn, MappingError> {
    let (bus, clock, robot) = (&part.bus, &part.clock, part.config.robot.as_str());
    let mut rivals = Rivals::listen(bus, robot)?;
    let waiting = Waiting::open(bus, robot)?;
    let mut leadership = Leadership::begin(part, &followed).await?;
    part.role.met();
    let mut inbox = Inbox::open(waiting, bus, robot)?;
    leadership.introduce(clock.now()).await;
    let company = Company::new(followed.leader.is_some(), Instant::now());
    let state = followed.state.take();
    drop(followed);
    if let Some(state) = state {
        // A request that changes the map needs the robot's lease from the first moment.
        leadership.hear(clock.now(), state).await;
    }
    bus.started();
    match leadership.go_on(part, company, &mut rivals, &mut inbox).await {
        Ending::StepsBack => {
            let followed = leadership.into_followed(clock.now()).await;
            Ok(Turn::Follow(Box::new(followed)))
        }
        Ending::Over => {
            leadership.finish(clock.now()).await;
            Ok(Turn::Over)
        }
    }
}

/// Why a leadership ends.
enum Ending {
    /// Another service leads, or may lead by now.
    StepsBack,
    /// Shutdown, or the bus was closed.
    Over,
}

/// State of a mapping service while it leads.
struct Leadership {
    config: MappingConfig,
    core: MappingCore,
    session: KeptSession,
    annotations: AnnotationBook,
    /// The map's frame, as last published.
    frame: MapFrame,
    /// The robot's present boot.
    boot_id: String,
    /// Whether the robot speaks another schema: its scans may mean something else.
    is_foreign: bool,
    authority: Authority,
    answered: FirstAnswers<MapReply>,
    annotated: FirstAnswers<Annotations>,
    /// Whether nothing can be stored, since a frozen service locks the folder.
    is_locked_out: bool,
    outbox: Outbox,
    graph_pace: GraphPace,
    /// Least time between two patches.
    period: Duration,
    /// Time of the last patch.
    published: Stamp,
    /// Whether there are changes to be published.
    pending: bool,
    /// When frame, places, zones and localisation are published again, since somebody else published other ones.
    restate_at: Option<Instant>,
    /// Whole maps being encoded.
    encoding: JoinSet<()>,
    /// Solves and redraws for coming scans.
    ahead: JoinSet<()>,
    metrics: MappingMetrics,
    /// The newest traced scan that is in no patch yet.
    trace: Option<Context>,
    pulse: Pulse,
    /// Shows others that this service leads.
    _alive: AliveToken,
    _tenancy: Tenancy,
}

impl Leadership {
    /// Begins the next term, and loads the map or takes it over.
    async fn begin(part: &MappingService, followed: &Followed) -> Result<Self, MappingError> {
        let mut beginning = Beginning::new(part, followed);
        beginning.tell();
        let tenancy = beginning.lock_folder().await?;
        let (pulse, alive) = beginning.begin_term()?;
        part.leads(true);
        let stored = beginning.session(&pulse).await?;
        let resumed = stored.as_ref().map(|stored| stored.head.frame);
        let mapper = beginning.mapper(&pulse, resumed.is_some()).await?;
        let mut annotations = beginning.book()?;
        let (core, frame) = match stored {
            Some(stored) => beginning.resume(&pulse, mapper, stored, &mut annotations).await?,
            None => beginning.start(mapper),
        };
        beginning.take_over_annotations(&mut annotations, resumed).await;
        let Beginning {
            config, is_locked_out, ..
        } = beginning;
        Ok(Self {
            core,
            session: KeptSession::new(resumed.is_some(), frame.map.frame),
            annotations,
            frame,
            boot_id: String::new(),
            is_foreign: false,
            authority: Authority::default(),
            answered: FirstAnswers::default(),
            annotated: FirstAnswers::default(),
            is_locked_out,
            outbox: Outbox::open(&part.bus, &config.robot)?,
            graph_pace: GraphPace::default(),
            period: Duration::from_secs_f64(1.0 / config.settings.publish_hz),
            published: Stamp::ZERO,
            pending: false,
            restate_at: None,
            encoding: JoinSet::new(),
            ahead: JoinSet::new(),
            metrics: MappingMetrics::new(&config.robot),
            trace: None,
            pulse,
            _alive: alive,
            _tenancy: tenancy,
            config,
        })
    }

    /// Draws scans and answers requests until this service ends or steps back.
    async fn go_on(
        &mut self,
        part: &MappingService,
        mut company: Company,
        rivals: &mut Rivals,
        inbox: &mut Inbox,
    ) -> Ending {
        let MappingService {
            bus, clock, shutdown, ..
        } = part;
        let robot = part.config.robot.as_str();
        let mut turns = tokio::time::interval(succession::BEAT);
        turns.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut body = Box::pin(ask_body(bus, robot, Duration::ZERO));
        let mut is_asking = true;
        loop {
            let due = self.published + self.period;
            self.pulse.turned();
            tokio::select! {
                // Before anything is written, whether another service leads by now.
                biased;
                () = self.pulse.suspended(), if company.has_copies() => {
                    tracing::warn!(robot, "this process was suspended: another mapping service may have led since");
                    return Ending::StepsBack;
                }
                () = shutdown.wait() => return Ending::Over,
                sign = rivals.next() => match sign {
                    Some(sign) => if company.takes(&sign, &self.pulse.leader(), Instant::now()) {
                        tracing::warn!(robot, "another mapping service leads");
                        return Ending::StepsBack;
                    },
                    None => return Ending::Over,
                },
                _ = turns.tick() => if company.is_cut_off(bus.is_connected().await, Instant::now()) {
                    tracing::warn!(robot, "this service is cut off: another mapping service may lead");
                    return Ending::StepsBack;
                },
                heard = inbox.next(!self.is_foreign) => match heard {
                    Some(heard) => self.take(heard, clock).await,
                    None => return Ending::Over,
                },
                () = tokio::time::sleep_until(self.restate_at.unwrap_or_else(Instant::now).into()), if self.restate_at.is_some() => {
                    self.restate();
                }
                () = clock.sleep_until(due), if self.pending => self.publish(clock.now()),
                answer = &mut body, if is_asking => {
                    is_asking = matches!(answer, Body::Foreign);
                    self.knows_body(answer);
                    if is_asking {
                        body.set(ask_body(bus, robot, FOREIGN));
                    }
                }
                Some(_) = self.encoding.join_next() => {}
                Some(_) = self.ahead.join_next() => {}
            }
        }
    }

    /// Takes one thing that was heard.
    async fn take(&mut self, heard: Heard, clock: &Clock) {
        let now = clock.now();
        match heard {
            Heard::State(state) => self.hear(now, *state).await,
            Heard::Request(request) => self.answer(request, now).await,
            Heard::Scan(scan) => self.insert(&scan.message, scan.trace, now).await,
            Heard::FurtherScan(scan) => self.insert_further(&scan.message, scan.trace, now),
            Heard::Frame(told) => self.doubt(told != self.frame),
            Heard::Annotations(told) => self.doubt(told != *self.annotations.now()),
            Heard::Localisation(told) => self.doubt(self.core.contradicts(&told)),
        }
    }

    /// Takes the robot's state: its boot, its frame and its lease.
    async fn hear(&mut self, now: Stamp, state: EdgeState) {
        self.boot_id = state.boot_id;
        self.core.hear_frame(state.frame);
        if let Some(frame) = self.core.untold_frame(now) {
            self.carry_over(&frame);
            let _ = self.keep(now, false).await;
            if self.tell_frame(frame) {
                self.publish(now);
            }
        }
        self.pending |= self.core.mapper.has_changes();
        self.authority.hear(now, state.lease);
    }

    /// Takes the robot's answer about its body.
    fn knows_body(&mut self, body: Body) {
        self.is_foreign = matches!(body, Body::Foreign);
        if let Body::Known(footprint) = body {
            self.core.mapper.set_footprint(footprint);
        }
    }

    /// This part's name in traces.
    fn part(&self) -> String {
        format!("mapping-{}", self.config.robot)
    }

    /// Publishes and stores what there is, and sends the replies that are still being encoded; the caller sets the deadline for the whole
    /// exit.
    async fn finish(&mut self, now: Stamp) {
        self.publish(now);
        let _ = self.keep(now, true).await;
        while self.encoding.join_next().await.is_some() {}
    }

    /// What a copy knows of this leader, from this leader itself.
    async fn into_followed(mut self, now: Stamp) -> Followed {
        // The folder is still this service's: if nobody else has taken over, it goes on with its session.
        let _ = self.keep(now, true).await;
        let leader = self.pulse.leader();
        let mut followed = Followed {
            leader: Some(MappingLeader {
                map: self.core.mapper.map().clone(),
                ..leader
            }),
            info: Some(self.core.mapper.info()),
            annotations: Some(self.annotations.now().clone()),
            ..Followed::default()
        };
        // `false`, and no map, if it has no cells.
        let _ = followed.replica.replace(&self.core.mapper.reply());
        followed
    }
}

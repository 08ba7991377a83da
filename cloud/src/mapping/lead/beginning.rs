//! Beginning. With which term, map, places and zones does a service begin to lead?
//!
//! After a takeover with those of the leader that it followed; otherwise with what is in its own folder.

use zenav_mapping::Mapper;
use zenav_protocol::bus::{AliveToken, BusError};
use zenav_protocol::messages::{Annotations, MapFrame, MapRef, MappingLeader};
use zenav_protocol::topics::{ALIVE_COMPONENT, alive_key};

use super::super::annotations::AnnotationBook;
use super::super::follow::{Followed, LEADER};
use super::super::service::MappingService;
use super::super::slam_session::Stored;
use super::super::storage::{self, Tenancy};
use super::super::{MappingConfig, MappingCore, MappingError, PoseSource, succession};
use super::pulse::Pulse;

/// What a service begins with.
pub(super) struct Beginning<'a> {
    part: &'a MappingService,
    followed: &'a Followed,
    /// The leader whose map is taken over.
    inherited: Option<&'a MappingLeader>,
    /// Without the folder if nothing can be stored there.
    pub(super) config: MappingConfig,
    /// Whether nothing can be stored, since a frozen service locks the folder.
    pub(super) is_locked_out: bool,
    /// Whether the folder was last that of the leader before, and has its whole map.
    is_leaders_folder: bool,
}

impl<'a> Beginning<'a> {
    /// `followed`: what was known of the leader before.
    pub(super) fn new(part: &'a MappingService, followed: &'a Followed) -> Self {
        // An almost right map is better than none.
        let almost = followed.leader.as_ref().filter(|_| followed.replica.has_map());
        Self {
            part,
            followed,
            inherited: followed.inherited().or(almost),
            config: part.config.clone(),
            is_locked_out: false,
            is_leaders_folder: false,
        }
    }

    fn is_takeover(&self) -> bool {
        self.followed.leader.is_some()
    }

    /// Logs what is taken over, and counts it.
    pub(super) fn tell(&self) {
        let Some(leader) = &self.followed.leader else { return };
        self.part.metrics.took_over();
        let (robot, map) = (self.config.robot.as_str(), self.followed.replica.map().id.as_str());
        if self.followed.inherited().is_some() {
            tracing::warn!(robot, map, "takes over: the mapping service that led is gone or silent");
        } else if self.inherited.is_some() {
            tracing::error!(
                robot,
                map,
                "takes over with an older map: the newest one of the mapping service that led had not arrived"
            );
        } else if leader.map.revision > 0 {
            tracing::error!(
                robot,
                "takes over without the map of the mapping service that led, which had not arrived: it begins as after a restart"
            );
        }
    }

    /// Locks the robot's folder, if there is one. At a takeover a copy may hold the lock for a moment, to store what it has followed; a
    /// leader that is frozen holds it for longer, and this one then stores nothing.
    ///
    /// # Errors
    /// [`MappingError::InUse`] if another service uses the folder, and it is no takeover.
    pub(super) async fn lock_folder(&mut self) -> Result<Tenancy, MappingError> {
        let Some(folder) = self.config.folder.as_deref() else {
            return Ok(Tenancy::default());
        };
        let mut locked = storage::lock(folder, &self.part.name);
        if self.is_takeover() && matches!(locked, Err(MappingError::InUse(_))) {
            tokio::time::sleep(succession::BEAT).await;
            locked = storage::lock(folder, &self.part.name);
        }
        let tenancy = match locked {
            Err(MappingError::InUse(folder)) if self.is_takeover() => {
                tracing::error!(
                    robot = self.config.robot,
                    folder = %folder.display(),
                    "the mapping service that led still locks the folder: nothing is stored until a restart"
                );
                self.config.folder = None;
                self.is_locked_out = true;
                Tenancy::default()
            }
            locked => locked?,
        };
        let leader = self.followed.leader.as_ref().filter(|leader| tenancy.was_of(leader));
        let (robot, folder) = (&self.config.robot, self.config.folder.as_deref());
        self.is_leaders_folder = leader.is_some_and(|leader| storage::has_map_of_term(robot, folder, leader.term));
        Ok(tenancy)
    }

    /// Begins the next term: others follow from here on, however long it takes to load the map.
    ///
    /// # Errors
    /// If the bus is closed, or a key cannot be declared.
    pub(super) fn begin_term(&self) -> Result<(Pulse, AliveToken), BusError> {
        let (bus, robot, folder) = (
            &self.part.bus,
            self.config.robot.as_str(),
            self.config.folder.as_deref(),
        );
        let known = self.followed.leader.as_ref().map_or(0, |leader| leader.term);
        let noted = storage::note_term(robot, folder, 0);
        let term = noted.max(known).saturating_add(1);
        // Before anybody hears of it.
        if self.inherited.is_none() || self.is_leaders_folder {
            storage::note_leadership(robot, folder, term);
        } else {
            // What is stored there is older than the inherited map, until this service stores its own.
            storage::note_term(robot, folder, term);
        }
        let leader = MappingLeader {
            name: self.part.name.clone(),
            term,
            map: MapRef::default(),
            held: self.inherited.is_some_and(|leader| leader.held),
        };
        let pulse = Pulse::begin(bus, robot, leader)?;
        let alive = bus.declare_alive(alive_key(ALIVE_COMPONENT, &[robot, LEADER]))?;
        Ok((pulse, alive))
    }

    /// The session of SLAM to go on with, if there is one.
    ///
    /// # Errors
    /// [`MappingError::Session`], as [`storage::session`]; none at a takeover.
    pub(super) async fn session(&self, pulse: &Pulse) -> Result<Option<Stored>, MappingError> {
        // Whatever another service stored here before belongs to an older map than the inherited one.
        if self.inherited.is_some() && !self.is_leaders_folder {
            return Ok(None);
        }
        match pulse.during(storage::session(&self.config)).await {
            Err(error) if self.is_takeover() => {
                tracing::error!(
                    robot = self.config.robot,
                    %error,
                    "takes over without the session of SLAM"
                );
                Ok(None)
            }
            stored => stored,
        }
    }

    /// The map: an empty one for a session of SLAM to be drawn in, else the leader's, else the stored one.
    ///
    /// # Errors
    /// [`MappingError::NoMap`] and [`MappingError::StoredMap`] if the robot is to be localised in a map that there is not.
    pub(super) async fn mapper(&self, pulse: &Pulse, has_session: bool) -> Result<Mapper, MappingError> {
        let config = &self.config;
        let mapper = match self.inherited {
            _ if has_session => storage::empty(config),
            Some(leader) => storage::inherit(config, leader, self.followed),
            None => pulse.during(storage::begin(config)).await?,
        };
        if config.poses.source == PoseSource::Localise && !mapper.is_stored() && self.inherited.is_none() {
            let folder = config.folder.as_ref();
            return Err(MappingError::NoMap(folder.map_or_else(
                || "a robot without a folder".to_owned(),
                |folder| folder.display().to_string(),
            )));
        }
        Ok(mapper)
    }

    /// Places and zones in the robot's folder.
    ///
    /// # Errors
    /// [`MappingError::Annotations`] if they cannot be read; at a takeover they are set aside.
    pub(super) fn book(&self) -> Result<AnnotationBook, MappingError> {
        let MappingConfig {
            robot,
            places,
            zones,
            folder,
            ..
        } = &self.config;
        if self.is_takeover() {
            AnnotationBook::open_or_set_aside(robot, places.clone(), zones, folder.as_deref())
        } else {
            AnnotationBook::open(places.clone(), zones, folder.as_deref())
        }
    }

    /// Goes on with a session of SLAM, whose map is drawn anew, and with places and zones where it had carried them.
    ///
    /// # Errors
    /// [`MappingError::Session`] if drawing fails.
    pub(super) async fn resume(
        &self,
        pulse: &Pulse,
        mapper: Mapper,
        stored: Stored,
        book: &mut AnnotationBook,
    ) -> Result<(MappingCore, MapFrame), MappingError> {
        let core = MappingCore::new(mapper, &self.config.poses);
        book.go_on(&stored.head.annotations, stored.head.frame);
        let frame = MapFrame {
            map: MapRef {
                frame: stored.head.frame,
                ..core.mapper.map().clone()
            },
            parts: stored.head.parts.clone(),
            ..MapFrame::default()
        };
        // Draws the whole map, so off the async threads.
        let drawn = tokio::task::spawn_blocking(move || core.going_on(stored));
        let core = pulse.during(drawn).await.map_err(|error| MappingError::Session {
            folder: self.config.folder.clone().unwrap_or_default(),
            problem: error.to_string(),
        })?;
        Ok((core, frame))
    }

    /// Goes on in a map without a session of SLAM, which begins where the robot is localised in it.
    pub(super) fn start(&self, mapper: Mapper) -> (MappingCore, MapFrame) {
        let frame = MapFrame {
            map: MapRef {
                frame: mapper.map().frame,
                ..MapRef::default()
            },
            ..MapFrame::default()
        };
        let has_map = !mapper.info().spec.is_empty();
        let mut core = MappingCore::new(mapper, &self.config.poses);
        if has_map {
            core.locate_first();
        }
        if self.inherited.is_some() && self.config.poses.source == PoseSource::Slam {
            tracing::warn!(
                robot = self.config.robot,
                "no session of SLAM here has the whole map that was followed: a new one begins where the robot is localised in that map"
            );
        }
        (core, frame)
    }

    /// Takes over the leader's places and zones; `resumed`: the frame of the session that this service goes on with.
    pub(super) async fn take_over_annotations(&self, book: &mut AnnotationBook, resumed: Option<u64>) {
        // The leader's own folder has them, and its session knows where they were carried; unless the file was set aside.
        let is_needed = |told: &&Annotations| !self.is_leaders_folder || told.revision > book.now().revision;
        if let Some(told) = self.followed.annotations.as_ref().filter(is_needed) {
            book.take_over(&self.config.robot, told).await;
            if let Some(frame) = resumed {
                book.are_in(frame);
            }
        }
    }
}

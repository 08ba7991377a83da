//! Book. The leader's places and zones, as a copy keeps them.

use tokio::task::JoinSet;
use zenav_protocol::bus::Bus;
use zenav_protocol::messages::{AnnotateRequest, Annotations, MappingLeader};
use zenav_protocol::topics::ANNOTATE;

use super::super::MappingError;
use super::super::annotations::AnnotationBook;
use super::super::service::MappingService;
use super::{Followed, PATIENCE};

/// The leader's places and zones, as a copy keeps them.
pub(super) struct FollowedBook {
    book: AnnotationBook,
    /// Name of the leader that was asked for its list last.
    asked_of: Option<String>,
    /// Answers on their way: name of the leader that was asked, and its list.
    pub(super) asked: JoinSet<Option<(String, Annotations)>>,
}

impl FollowedBook {
    /// The list of this service's own folder.
    ///
    /// # Errors
    /// [`MappingError::Annotations`], as for a service that leads.
    pub(super) async fn open(part: &MappingService, followed: &Followed) -> Result<Self, MappingError> {
        let config = &part.config;
        let mut book = AnnotationBook::open(config.places.clone(), &config.zones, config.folder.as_deref())?;
        // A service that has led knows where it carried them, and without a folder all of them.
        let is_older = |known: &&Annotations| known.revision > book.now().revision || known.frame != book.now().frame;
        if let Some(known) = followed.annotations.as_ref().filter(is_older) {
            book.follow(&config.robot, known).await;
        }
        let led = followed.leader.as_ref().filter(|leader| leader.name == part.name);
        Ok(Self {
            book,
            asked_of: led.map(|leader| leader.name.clone()),
            asked: JoinSet::new(),
        })
    }

    /// Places and zones as they are known here.
    pub(super) fn now(&self) -> &Annotations {
        self.book.now()
    }

    /// Whether this is the list of the leader.
    pub(super) fn is_of(&self, leader: Option<&MappingLeader>) -> bool {
        leader.is_some_and(|leader| self.asked_of.as_deref() == Some(leader.name.as_str()))
    }

    /// Takes a published list. One that does not succeed the list known here may be of a former leader: the present one is asked.
    pub(super) async fn take(&mut self, robot: &str, told: &Annotations) {
        if self.book.is_succeeded_by(told) {
            // An answer on its way may be older.
            self.asked = JoinSet::new();
            self.book.follow(robot, told).await;
        } else {
            self.asked_of = None;
        }
    }

    /// Takes the answer of the leader of this name.
    pub(super) async fn take_answer(&mut self, robot: &str, leader: String, told: &Annotations) {
        self.book.follow(robot, told).await;
        self.asked_of = Some(leader);
    }

    /// Asks the leader, unless it has answered.
    pub(super) fn ask(&mut self, bus: &Bus, robot: &str, leader: &MappingLeader) {
        if !self.is_of(Some(leader)) && self.asked.is_empty() {
            let (bus, robot, name) = (bus.clone(), robot.to_owned(), leader.name.clone());
            self.asked.spawn(async move {
                let request = AnnotateRequest::default();
                let told = bus.ask(&ANNOTATE, &[&robot], &request, PATIENCE).await.ok()?;
                Some((name, told))
            });
        }
    }
}

// A participant of OpenDDS that sends a text on a topic, or receives it.
// peer INI send|receive DOMAIN TOPIC TEXT SECONDS [FILE with NAME=VALUE lines: its properties]
// With -DPQSEC_HEADER, the properties are those of the exported header, which loads the plugin.
// With -DPQSEC_LISTENER, it receives until SECONDS are over, and parts from all peers when a
// plugin tells its listener that one was revoked or expired.

#ifdef PQSEC_HEADER
#include "pqsec_participant.h"
#endif

#include <dds/DCPS/Marked_Default_Qos.h>
#include <dds/DCPS/RTPS/RtpsDiscovery.h>
#include <dds/DCPS/Service_Participant.h>
#ifdef PQSEC_LISTENER
#include <dds/DCPS/LocalObject.h>
#include <dds/DCPS/security/framework/SecurityRegistry.h>
#include <dds/DdsSecurityCoreC.h>
#endif
#include <dds/DCPS/transport/rtps_udp/RtpsUdp.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>

#include "opendds_peerTypeSupportImpl.h"

static int say(const char* what, int code) {
  printf("%s\n", what);
  fflush(stdout);
  return code;
}

#ifndef PQSEC_HEADER
static void secure(DDS::DomainParticipantQos& qos, const char* path) {
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);) {
    const size_t end = line.find('=');
    const CORBA::ULong count = qos.property.value.length();
    qos.property.value.length(count + 1);
    qos.property.value[count].name = line.substr(0, end).c_str();
    qos.property.value[count].value = line.substr(end + 1).c_str();
    qos.property.value[count].propagate = false;
  }
}
#endif

#ifdef PQSEC_LISTENER
namespace security = DDS::Security;

static void part(DDS::DomainParticipant_ptr participant) {
  DDS::InstanceHandleSeq peers;
  participant->get_discovered_participants(peers);
  for (CORBA::ULong i = 0; i < peers.length(); i++) participant->ignore_participant(peers[i]);
}

class OfIdentities : public virtual OpenDDS::DCPS::LocalObject<security::AuthenticationListener> {
 public:
  explicit OfIdentities(DDS::DomainParticipant_ptr participant) : participant_(participant) {}
  CORBA::Boolean on_revoke_identity(security::Authentication_ptr, security::IdentityHandle,
                                    security::SecurityException&) override {
    say("told of an identity", 0);
    part(participant_);
    return true;
  }
  CORBA::Boolean on_status_changed(security::Authentication_ptr, security::IdentityHandle,
                                   security::AuthStatusKind, security::SecurityException&) override {
    return true;
  }

 private:
  DDS::DomainParticipant_ptr participant_;
};

class OfPermissions : public virtual OpenDDS::DCPS::LocalObject<security::AccessControlListener> {
 public:
  explicit OfPermissions(DDS::DomainParticipant_ptr participant) : participant_(participant) {}
  CORBA::Boolean on_revoke_permissions(security::AccessControl_ptr,
                                       security::PermissionsHandle) override {
    say("told of permissions", 0);
    part(participant_);
    return true;
  }

 private:
  DDS::DomainParticipant_ptr participant_;
};

static void listen(DDS::DomainParticipant_ptr participant) {
  security::SecurityException why;
  const OpenDDS::Security::SecurityConfig_rch plugins = TheSecurityRegistry->default_config();
  security::AuthenticationListener_var identities = new OfIdentities(participant);
  security::AccessControlListener_var permissions = new OfPermissions(participant);
  plugins->get_authentication()->set_listener(identities, why);
  plugins->get_access_control()->set_listener(permissions, why);
}
#endif

static int send(DDS::DomainParticipant_ptr participant, DDS::Topic_ptr topic, const char* text,
                int seconds) {
  DDS::Publisher_var publisher = participant->create_publisher(
      PUBLISHER_QOS_DEFAULT, 0, OpenDDS::DCPS::DEFAULT_STATUS_MASK);
  DDS::DataWriter_var any = publisher->create_datawriter(topic, DATAWRITER_QOS_DEFAULT, 0,
                                                         OpenDDS::DCPS::DEFAULT_STATUS_MASK);
  if (!any.in()) return say("no writer", 3);
  Lab::TextDataWriter_var writer = Lab::TextDataWriter::_narrow(any);
  bool matched = false;
  for (int i = 0; i < seconds * 5; i++) {
    Lab::Text sample;
    sample.id = 1;
    sample.value = text;
    writer->write(sample, DDS::HANDLE_NIL);
    usleep(200000);
    DDS::PublicationMatchedStatus status;
    any->get_publication_matched_status(status);
    if (matched && status.current_count == 0) break;
    if (status.current_count != 0 && !matched) matched = say("matched", 1) != 0;
  }
  return 0;
}

static int receive(DDS::DomainParticipant_ptr participant, DDS::Topic_ptr topic, int seconds) {
  DDS::Subscriber_var subscriber = participant->create_subscriber(
      SUBSCRIBER_QOS_DEFAULT, 0, OpenDDS::DCPS::DEFAULT_STATUS_MASK);
  DDS::DataReader_var any = subscriber->create_datareader(topic, DATAREADER_QOS_DEFAULT, 0,
                                                          OpenDDS::DCPS::DEFAULT_STATUS_MASK);
  if (!any.in()) return say("no reader", 3);
  Lab::TextDataReader_var reader = Lab::TextDataReader::_narrow(any);
  for (int i = 0; i < seconds * 10; i++) {
    Lab::Text sample;
    DDS::SampleInfo info;
    if (reader->take_next_sample(sample, info) == DDS::RETCODE_OK && info.valid_data) {
      say((std::string("heard ") + sample.value.in()).c_str(), 0);
#ifndef PQSEC_LISTENER
      return 0;
#endif
    }
    usleep(100000);
  }
  return 0;
}

int main(int, char** words) {
  char option[] = "-DCPSConfigFile";
  char* options[] = {words[0], option, words[1], 0};
  int count = 3;
  DDS::DomainParticipantFactory_var factory = TheParticipantFactoryWithArgs(count, options);
  DDS::DomainParticipantQos qos;
  factory->get_default_participant_qos(qos);
#ifdef PQSEC_HEADER
  pqsec::secure(qos);
#else
  secure(qos, words[7]);
#endif
  DDS::DomainParticipant_var participant = factory->create_participant(
      atoi(words[3]), qos, 0, OpenDDS::DCPS::DEFAULT_STATUS_MASK);
  if (!participant.in()) return say("no participant", 1);
  say("joined", 0);
#ifdef PQSEC_LISTENER
  listen(participant);
#endif
  Lab::TextTypeSupport_var support = new Lab::TextTypeSupportImpl;
  support->register_type(participant, "");
  CORBA::String_var type = support->get_type_name();
  DDS::Topic_var topic = participant->create_topic(words[4], type, TOPIC_QOS_DEFAULT, 0,
                                                   OpenDDS::DCPS::DEFAULT_STATUS_MASK);
  if (!topic.in()) return say("no topic", 2);
  const int seconds = atoi(words[6]);
  const int code = std::string(words[2]) == "send" ? send(participant, topic, words[5], seconds)
                                                   : receive(participant, topic, seconds);
  participant->delete_contained_entities();
  factory->delete_participant(participant);
  TheServiceParticipant->shutdown();
  return code != 0 ? code : say("over", 0);
}

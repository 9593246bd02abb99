// Fast DDS's security plugins behind one function of C, to be called from Python.
//
// The library's own factory makes authentication, access control and cryptography, as it
// does for a DomainParticipant; here there is none. Tokens come and go as the CDR that
// travels, little-endian, read and written by the library's own code. PQSEC_FASTDDS is 2, built
// against the public headers of Fast DDS 2.9, or 3, which installs fewer: there it has no
// cryptography, and no endpoints of others.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <exception>
#include <map>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <fastdds/dds/log/Log.hpp>

#include "stack.hpp"

#if PQSEC_FASTDDS == 2
#include <fastdds/rtps/builtin/data/ParticipantProxyData.h>
#include <fastdds/rtps/messages/CDRMessage.h>
#include <fastdds/rtps/security/common/SharedSecretHandle.h>
#include <fastdds/rtps/security/cryptography/Cryptography.h>
#else
namespace eprosima::fastdds::rtps {

class CDRMessage {
public:
    static bool addData(CDRMessage_t*, const octet*, const std::uint32_t);
    static bool add_string(CDRMessage_t*, const std::string&);
    static bool addPropertySeq(CDRMessage_t*, const PropertySeq&);
    static bool addBinaryPropertySeq(CDRMessage_t*, const BinaryPropertySeq&, bool);
    static bool readDataHolder(CDRMessage_t*, DataHolder&, const std::uint32_t size);
    static bool readDataHolder(CDRMessage_t* message, DataHolder& token) {
        return readDataHolder(message, token, message->length);
    }
};

namespace security {

using IdentityHandle = Handle;
using PermissionsHandle = Handle;
using HandshakeHandle = Handle;
using SecretHandle = Handle;
using HandshakeMessageToken = DataHolder;

}  // namespace security
}  // namespace eprosima::fastdds::rtps
#endif

namespace PQSEC_RTPS::security {

class Cryptography;

// Exported by the library, declared in none of its public headers.
class SecurityPluginFactory {
public:
    Authentication* create_authentication_plugin(const PropertyPolicy&);
    AccessControl* create_access_control_plugin(const PropertyPolicy&);
    Cryptography* create_cryptography_plugin(const PropertyPolicy&);
};

}  // namespace PQSEC_RTPS::security

namespace {

using eprosima::fastdds::dds::Log;
using eprosima::fastdds::dds::LogConsumer;
using namespace rtps;
using namespace rtps::security;

using Octets = std::vector<octet>;
using Result = ValidationResult_t;

#if PQSEC_FASTDDS == 2
constexpr std::size_t PROTECTION = 256;  // more bytes than it adds to a submessage
#endif

// The arguments of a call; what it does not need is empty.
struct Question {
    std::size_t number;  // a domain, or the handle of a peer or a handshake
    Octets first;
    Octets second;
};

GUID_t guid_of(const Octets& data) {
    GUID_t guid;
    constexpr std::size_t prefix = sizeof guid.guidPrefix.value;
    if (data.size() != prefix + sizeof guid.entityId.value) {
        throw std::invalid_argument("not a GUID");
    }
    std::copy_n(data.begin(), prefix, guid.guidPrefix.value);
    std::copy(data.begin() + prefix, data.end(), guid.entityId.value);
    return guid;
}

Octets octets_of(const GUID_t& guid) {
    Octets data(std::begin(guid.guidPrefix.value), std::end(guid.guidPrefix.value));
    data.insert(data.end(), std::begin(guid.entityId.value), std::end(guid.entityId.value));
    return data;
}

DataHolder token_of(Octets data) {
    CDRMessage_t message(0);
    message.init(data.data(), static_cast<std::uint32_t>(data.size()));
    message.length = message.max_size;
    message.msg_endian = LITTLEEND;
    DataHolder token;
    if (!CDRMessage::readDataHolder(&message, token)) {
        throw std::invalid_argument("not the CDR of a token");
    }
    return token;
}

// What travels: properties that are not to be propagated are left out.
Octets octets_of(const DataHolder& token) {
    CDRMessage_t message(static_cast<std::uint32_t>(DataHolderHelper::serialized_size(token)));
    message.msg_endian = LITTLEEND;
    if (!CDRMessage::add_string(&message, token.class_id()) ||
            !CDRMessage::addPropertySeq(&message, token.properties()) ||
            !CDRMessage::addBinaryPropertySeq(&message, token.binary_properties(), false)) {
        throw std::length_error("a token larger than its serialized size");
    }
    return Octets(message.buffer, message.buffer + message.length);
}

// A credential does not travel: all of it.
Octets octets_of_credential(DataHolder credential) {
    for (Property& each : credential.properties()) {
        each.propagate(true);
    }
    return octets_of(credential);
}

// An endpoint's topic, and its partitions.
struct Names {
    std::string topic;
    std::vector<std::string> partitions;
};

Names names_of(const Octets& data) {
    std::vector<std::string> texts;
    for (auto at = data.begin(); at != data.end(); ++at) {
        const auto end = std::find(at, data.end(), 0);
        texts.emplace_back(at, end);
        at = end;
    }
    return {texts.at(0), {texts.begin() + 1, texts.end()}};
}

#if PQSEC_FASTDDS == 2
template<typename ProxyData>
void fill(ProxyData& data, Names names) {
    data.topicName(names.topic);
    data.m_qos.m_partition.setNames(names.partitions);
}
#endif

std::uint32_t domain_of(const Question& of) {
    return static_cast<std::uint32_t>(of.number);
}

CDRMessage_t message_of(const Octets& data) {
    CDRMessage_t message(static_cast<std::uint32_t>(data.size()));
    message.msg_endian = BIGEND;
    CDRMessage::addData(&message, data.data(), message.max_size);
    message.pos = 0;
    return message;
}

// To what was said, once.
void add(std::string& text, const std::string& words) {
    if (!words.empty() && text.find(words) == std::string::npos) {
        text += text.empty() ? words : "; " + words;
    }
}

// The library's log: most refusals are only a warning there.
class Heard {
public:
    static Heard& instance() {
        static Heard& heard = *new Heard;  // as long as the log's thread, to the end
        return heard;
    }

    // From now on; what another of these heard before, in the same process, it hears no more.
    void listen() {
        Log::ClearConsumers();
        Log::RegisterConsumer(std::make_unique<Consumer>());
        Log::SetVerbosity(Log::Kind::Warning);
    }

    std::string take() {
        Log::Flush();
        const std::lock_guard<std::mutex> lock(mutex_);
        return std::exchange(text_, std::string());
    }

private:
    struct Consumer final : LogConsumer {
        void Consume(const Log::Entry& entry) override {
            const std::lock_guard<std::mutex> lock(instance().mutex_);
            add(instance().text_, entry.message);
        }
    };

    std::mutex mutex_;
    std::string text_;
};

// The calls that a DomainParticipant's security manager makes, one by one. Handles are
// indexes, its own first; what the plugins made is given back to them in the end.
class Participant {
public:
    explicit Participant(const PropertyPolicy& properties) {
        attributes_.properties = properties;
        SecurityPluginFactory factory;
        authentication_.reset(factory.create_authentication_plugin(properties));
        access_.reset(factory.create_access_control_plugin(properties));
        bool complete = authentication_ && access_;
#if PQSEC_FASTDDS == 2
        cryptography_.reset(factory.create_cryptography_plugin(properties));
        complete = complete && cryptography_;
#endif
        if (!complete) {
            throw std::runtime_error("no such plugins");
        }
    }

    ~Participant() {
        for (const Handshake& each : handshakes_) {
            authentication_->return_handshake_handle(each.handle, exception);
        }
        for (PermissionsHandle* each : permissions_) {
            access_->return_permissions_handle(each, exception);
        }
        for (IdentityHandle* each : identities_) {
            authentication_->return_identity_handle(each, exception);
        }
    }

    Participant(const Participant&) = delete;
    Participant& operator=(const Participant&) = delete;

    Result validate_local_identity(const Question& of) {
        IdentityHandle* made = nullptr;
        GUID_t adjusted;
        const Result result = authentication_->validate_local_identity(
            &made, adjusted, 0, attributes_, guid_of(of.first), exception);
        output = octets_of(adjusted);
        keep(identities_, made);
        return result;
    }

    Result get_identity_token(const Question&) {
        IdentityToken* token = nullptr;
        if (!authentication_->get_identity_token(&token, self(), exception)) {
            return VALIDATION_FAILED;
        }
        output = octets_of(*token);
        authentication_->return_identity_token(token, exception);
        return VALIDATION_OK;
    }

    Result validate_local_permissions(const Question& of) {
        const auto domain = static_cast<std::uint32_t>(of.number);
        return keep(permissions_, access_->validate_local_permissions(
            *authentication_, self(), domain, attributes_, exception));
    }

    Result check_create_participant(const Question& of) {
        const auto domain = static_cast<std::uint32_t>(of.number);
        return result(access_->check_create_participant(
            *permissions_.at(0), domain, attributes_, exception));
    }

    Result get_permissions_credential_token(const Question&) {
        PermissionsCredentialToken* token = nullptr;
        if (!access_->get_permissions_credential_token(&token, *permissions_.at(0), exception)) {
            return VALIDATION_FAILED;
        }
        output = octets_of_credential(*token);
        access_->return_permissions_credential_token(token, exception);
        return VALIDATION_OK;
    }

    Result get_permissions_token(const Question&) {
        PermissionsToken* token = nullptr;
        if (!access_->get_permissions_token(&token, *permissions_.at(0), exception)) {
            return VALIDATION_FAILED;
        }
        output = octets_of(*token);
        access_->return_permissions_token(token, exception);
        return VALIDATION_OK;
    }

    Result set_permissions_credential_and_token(const Question& of) {
        PermissionsCredentialToken credential = token_of(of.first);
        return result(authentication_->set_permissions_credential_and_token(
            self(), credential, exception));
    }

    Result validate_remote_identity(const Question& of) {
        IdentityHandle* made = nullptr;
        const Result result = authentication_->validate_remote_identity(
            &made, self(), token_of(of.second), guid_of(of.first), exception);
        keep(identities_, made);
        return result;
    }

    Result begin_handshake_request(const Question& of) {
        HandshakeHandle* made = nullptr;
        HandshakeMessageToken* message = nullptr;
        const Result result = authentication_->begin_handshake_request(
            &made, &message, self(), *identities_.at(of.number), message_of(of.first),
            exception);
        return begun(of.number, made, message, result);
    }

    Result begin_handshake_reply(const Question& of) {
        HandshakeHandle* made = nullptr;
        HandshakeMessageToken* message = nullptr;
        const Result result = authentication_->begin_handshake_reply(
            &made, &message, token_of(of.first), *identities_.at(of.number), self(),
            message_of(of.second), exception);
        return begun(of.number, made, message, result);
    }

    Result process_handshake(const Question& of) {
        Handshake& handshake = handshakes_.at(of.number);
        HandshakeMessageToken* message = nullptr;
        const Result result = authentication_->process_handshake(
            &message, token_of(of.first), *handshake.handle, exception);
        handshake.done = result == VALIDATION_OK || result == VALIDATION_OK_WITH_FINAL_MESSAGE;
        if (result == VALIDATION_OK_WITH_FINAL_MESSAGE) {
            output = octets_of(*message);
        }
        return result;
    }

    // Secret, challenge1 and challenge2, one after the other.
    Result get_shared_secret(const Question& of) {
        auto secret = shared_secret(handshakes_.at(of.number));
        auto& data = static_cast<SharedSecretHandle&>(*secret)->data_;
        for (const char* name : {"SharedSecret", "Challenge1", "Challenge2"}) {
            const auto found = std::find_if(data.begin(), data.end(), [&](const auto& each) {
                return each.name() == name;
            });
            if (found == data.end()) {
                throw std::logic_error(std::string("there is no ") + name);
            }
            output.insert(output.end(), found->value().begin(), found->value().end());
        }
        return VALIDATION_OK;
    }

    Result get_authenticated_peer_credential_token(const Question& of) {
        PermissionsCredentialToken* token = nullptr;
        if (!authentication_->get_authenticated_peer_credential_token(
                    &token, *identities_.at(of.number), exception)) {
            return VALIDATION_FAILED;
        }
        output = octets_of_credential(*token);
        authentication_->return_authenticated_peer_credential_token(token, exception);
        return VALIDATION_OK;
    }

    Result validate_remote_permissions(const Question& of) {
        return keep(permissions_, access_->validate_remote_permissions(
            *authentication_, self(), *permissions_.at(0), *identities_.at(of.number),
            token_of(of.first), token_of(of.second), exception));
    }

    // The number is the domain; first are the topic and the partitions, each with a zero.
    Result check_create_datawriter(const Question& of) {
        const Names names = names_of(of.first);
        return result(access_->check_create_datawriter(
            *permissions_.at(0), domain_of(of), names.topic, names.partitions, exception));
    }

    Result check_create_datareader(const Question& of) {
        const Names names = names_of(of.first);
        return result(access_->check_create_datareader(
            *permissions_.at(0), domain_of(of), names.topic, names.partitions, exception));
    }

#if PQSEC_FASTDDS == 2
    // The permissions validated last are those of the peer.
    Result check_remote_participant(const Question& of) {
        const ParticipantProxyData data{RTPSParticipantAllocationAttributes()};
        return result(access_->check_remote_participant(
            *permissions_.back(), domain_of(of), data, exception));
    }

    Result check_remote_datawriter(const Question& of) {
        WriterProxyData data(1, 1);
        fill(data, names_of(of.first));
        return result(access_->check_remote_datawriter(
            *permissions_.back(), domain_of(of), data, exception));
    }

    Result check_remote_datareader(const Question& of) {
        ReaderProxyData data(1, 1);
        fill(data, names_of(of.first));
        bool relay_only = false;
        return result(access_->check_remote_datareader(
            *permissions_.back(), domain_of(of), data, relay_only, exception));
    }

    // The keys of the participant, for the peer of a handshake.
    Result create_local_participant_crypto_tokens(const Question& of) {
        ParticipantCryptoTokenSeq tokens;
        ParticipantCryptoHandle& peer = peer_keys(handshakes_.at(of.number));
        const bool good = cryptography_->cryptokeyexchange()
            ->create_local_participant_crypto_tokens(tokens, *own_keys_, peer, exception);
        if (good) {
            output = octets_of(tokens.at(0));
        }
        return result(good);
    }

    // As the writer of the volatile secure topic does, which sends the keys.
    Result encode_datawriter_submessage(const Question& of) {
        DatawriterCryptoHandle& writer = key_writer(handshakes_.at(of.number));
        std::vector<std::shared_ptr<DatareaderCryptoHandle>> no_receivers;
        CDRMessage_t encoded(static_cast<std::uint32_t>(of.first.size() + PROTECTION));
        return given(encoded, cryptography_->cryptotransform()->encode_datawriter_submessage(
            encoded, message_of(of.first), writer, no_receivers, exception));
    }

    // As its reader does. The plugin looks at the writer's keys, never at the reader's.
    Result decode_datawriter_submessage(const Question& of) {
        DatawriterCryptoHandle& writer = key_writer(handshakes_.at(of.number));
        CDRMessage_t encoded = message_of(of.first);
        CDRMessage_t plain(encoded.length);
        return given(plain, cryptography_->cryptotransform()->decode_datawriter_submessage(
            plain, encoded, writer, writer, exception));
    }
#endif

    void forget() {
        output.clear();
        handle = 0;
        exception = SecurityException(std::string());
        words.clear();
    }

    // Of the last call: what it gave, and what was said.
    Octets output;
    std::size_t handle = 0;
    SecurityException exception{std::string()};
    std::string words;

private:
    struct Handshake {
        std::size_t peer;
        HandshakeHandle* handle;
        bool done;
#if PQSEC_FASTDDS == 2
        std::shared_ptr<ParticipantCryptoHandle> keys;
#endif
    };

    IdentityHandle& self() {
        return *identities_.at(0);
    }

    static Result result(bool good) {
        return good ? VALIDATION_OK : VALIDATION_FAILED;
    }

    template<typename Item>
    Result keep(std::vector<Item*>& items, Item* made) {
        if (made != nullptr) {
            handle = items.size();
            items.push_back(made);
        }
        return result(made != nullptr);
    }

    Result begun(
            std::size_t peer, HandshakeHandle* made, const DataHolder* message, Result result) {
        if (made != nullptr) {
            handle = handshakes_.size();
            handshakes_.push_back(Handshake{peer, made, false});
            output = octets_of(*message);
        }
        return result;
    }

    Result given(const CDRMessage_t& message, bool good) {
        if (good) {
            output.assign(message.buffer, message.buffer + message.length);
        }
        return result(good);
    }

    std::shared_ptr<SecretHandle> shared_secret(const Handshake& handshake) {
        if (!handshake.done) {  // The plugin would read what is not there.
            throw std::logic_error("the handshake is not finished");
        }
        return authentication_->get_shared_secret(*handshake.handle, exception);
    }

#if PQSEC_FASTDDS == 2
    ParticipantCryptoHandle& peer_keys(Handshake& handshake) {
        CryptoKeyFactory& factory = *cryptography_->cryptokeyfactory();
        // The plugin does not look at identities and permissions.
        const IdentityHandle& peer = *identities_.at(handshake.peer);
        const PermissionsHandle& permissions = *permissions_.at(0);
        if (!own_keys_) {
            own_keys_ = factory.register_local_participant(
                self(), permissions, {}, ParticipantSecurityAttributes(), exception);
        }
        if (!handshake.keys) {
            handshake.keys = factory.register_matched_remote_participant(
                *own_keys_, peer, permissions, *shared_secret(handshake), exception);
        }
        return *handshake.keys;
    }

    DatawriterCryptoHandle& key_writer(Handshake& handshake) {
        const PropertySeq name{
            {"dds.sec.builtin_endpoint_name", "BuiltinParticipantVolatileMessageSecureWriter"}};
        return *cryptography_->cryptokeyfactory()->register_local_datawriter(
            peer_keys(handshake), name, EndpointSecurityAttributes(), exception);
    }
#endif

    RTPSParticipantAttributes attributes_;
    std::unique_ptr<Authentication> authentication_;
    std::unique_ptr<AccessControl> access_;
#if PQSEC_FASTDDS == 2
    std::unique_ptr<Cryptography> cryptography_;
    std::shared_ptr<ParticipantCryptoHandle> own_keys_;
#endif
    std::vector<IdentityHandle*> identities_;
    std::vector<PermissionsHandle*> permissions_;
    std::vector<Handshake> handshakes_;
};

using Function = Result (Participant::*)(const Question&);
#define NAMED(function) {#function, &Participant::function}
const std::map<std::string, Function> FUNCTIONS = {
    NAMED(validate_local_identity),
    NAMED(get_identity_token),
    NAMED(validate_local_permissions),
    NAMED(check_create_participant),
    NAMED(get_permissions_credential_token),
    NAMED(get_permissions_token),
    NAMED(set_permissions_credential_and_token),
    NAMED(validate_remote_identity),
    NAMED(begin_handshake_request),
    NAMED(begin_handshake_reply),
    NAMED(process_handshake),
    NAMED(get_shared_secret),
    NAMED(get_authenticated_peer_credential_token),
    NAMED(validate_remote_permissions),
    NAMED(check_create_datawriter),
    NAMED(check_create_datareader),
#if PQSEC_FASTDDS == 2
    NAMED(check_remote_participant),
    NAMED(check_remote_datawriter),
    NAMED(check_remote_datareader),
    NAMED(create_local_participant_crypto_tokens),
    NAMED(encode_datawriter_submessage),
    NAMED(decode_datawriter_submessage),
#endif
};

}  // namespace

extern "C" {

// What a call gave; good until the participant's next call.
struct Answer {
    std::int32_t code;  // ValidationResult_t
    std::size_t handle;
    const char* words;
    std::size_t words_size;
    const octet* data;
    std::size_t size;
};

// `pairs` are names and values in turns; nullptr if the plugins cannot be had.
Participant* fastdds_new(const char* const* pairs, std::size_t count) noexcept {
    try {
        PropertyPolicy properties;
        for (std::size_t at = 0; at + 1 < count; at += 2) {
            properties.properties().emplace_back(pairs[at], pairs[at + 1]);
        }
        return new Participant(properties);
    } catch (const std::exception&) {
        return nullptr;
    }
}

void fastdds_delete(Participant* participant) noexcept {
    delete participant;
}

void fastdds_call(
        Participant* participant, Answer* answer, const char* function, std::size_t number,
        const octet* first, std::size_t first_size, const octet* second,
        std::size_t second_size) noexcept {
    // Its log's thread has to run for each call, so who asks a million times does without.
    static const bool deaf = std::getenv("PQSEC_FASTDDS_DEAF") != nullptr;
    Participant& self = *participant;
    if (!deaf) {
        Heard::instance().listen();
    }
    std::string failure;
    self.forget();
    answer->code = VALIDATION_FAILED;
    try {
        const Question of{number, {first, first + first_size}, {second, second + second_size}};
        answer->code = static_cast<std::int32_t>((self.*FUNCTIONS.at(function))(of));
        failure = self.exception.what();
    } catch (const std::exception& error) {
        failure = error.what();
    }
    if (!deaf) {
        self.words = Heard::instance().take();
    }
    add(self.words, failure);
    answer->handle = self.handle;
    answer->words = self.words.data();
    answer->words_size = self.words.size();
    answer->data = self.output.data();
    answer->size = self.output.size();
}

}

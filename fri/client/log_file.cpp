// SPDX-License-Identifier: MIT
#include "log_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdarg>
#include <cstdio>
#include <cstring>
#include <stdexcept>

LogFile::LogFile()
    : file_(-1), made_(false), keep_(false), regular_(true), size_(0), rows_(0), error_(0), end_(0), buffer_()
{
}

LogFile::~LogFile()
{
    close();
    if (made_ && !keep_) {
        ::unlink(path_.c_str());
    }
}

/* Create the file; an existing one is never overwritten, except a device or pipe. */
void LogFile::create(const std::string &path)
{
    struct stat found;
    path_ = path;
    regular_ = ::stat(path.c_str(), &found) != 0 || S_ISREG(found.st_mode);
    file_ = ::open(path.c_str(), O_WRONLY | O_CLOEXEC | (regular_ ? O_CREAT | O_EXCL : 0), 0666);
    made_ = file_ >= 0 && regular_;
    if (file_ < 0) {
        const bool exists = errno == EEXIST;
        throw std::runtime_error("log " + path + ": " + std::strerror(errno) +
                                 (exists ? "; name a new file with --log, or remove this one"
                                         : "; name a file that can be written with --log"));
    }
}

/* Return whether a path is this open file, by device and inode: a second log must not overwrite the first. */
bool LogFile::same(const std::string &path) const
{
    struct stat mine, other;
    return is_open() && ::fstat(file_, &mine) == 0 && ::stat(path.c_str(), &other) == 0 &&
           mine.st_dev == other.st_dev && mine.st_ino == other.st_ino;
}

/* Add formatted text to the buffer, cut at its end. */
void LogFile::append(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    const int count = std::vsnprintf(buffer_ + size_, sizeof buffer_ - size_, format, arguments);
    va_end(arguments);
    size_ = std::min(size_ + static_cast<std::size_t>(std::max(count, 0)), sizeof buffer_ - 1);
}

void LogFile::end_row()
{
    append("\n");
    if (size_ > CAPACITY - ROOM) {
        flush();
    }
}

/* Write the buffer, which holds whole rows. Where only a part of it fits, the file is cut after the last whole row. */
void LogFile::flush()
{
    std::size_t done = 0;
    while (done < size_ && error_ == 0) {
        const ssize_t count = ::write(file_, buffer_ + done, size_ - done);
        error_ = count < 0 && errno != EINTR ? errno : 0;
        done += static_cast<std::size_t>(std::max<ssize_t>(count, 0));
    }
    while (done > 0 && buffer_[done - 1] != '\n') {
        --done;
    }
    end_ += static_cast<long long>(done);
    if (error_ != 0 && size_ > 0 && regular_ && ::ftruncate(file_, end_) != 0) {
        /* The file ends in the middle of a row; its whole rows are counted. */
    }
    rows_ += static_cast<unsigned long long>(std::count(buffer_, buffer_ + done, '\n'));
    size_ = 0;
}

/* Write the buffer and close the file; return the first error of all writes, 0 for none. */
int LogFile::close()
{
    if (!is_open()) {
        return error_;
    }
    flush();
    if (::close(file_) != 0 && error_ == 0) {
        error_ = errno;
    }
    file_ = -1;
    return error_;
}
